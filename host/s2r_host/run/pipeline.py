"""The order of a run, and how it ends: well, refused, stopped or interrupted, always with files to read."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.motion.obstacles import cloud_obstacle, table_obstacle
from s2r_host.perception.errors import AbstainError, NothingMovedError
from s2r_host.perception.estimate import JointEstimate
from s2r_host.run.belief import Belief, build_belief, estimate_part
from s2r_host.run.contact import corrected, touched_by_push
from s2r_host.run.feeling import Feeling, with_felt
from s2r_host.run.first_push import PUSH, DonePush, carry_out_push, prepare_push
from s2r_host.run.journal import Journal
from s2r_host.run.manipulate import (
    DoneManipulation,
    carry_out_manipulation,
    measure_now,
    prepare_manipulation,
)
from s2r_host.run.observe import Observation, observe
from s2r_host.run.reactive import carry_out_reactively
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Executed, Session, open_session
from s2r_host.run.settings import RunSettings
from s2r_host.run.travel import go_to
from s2r_protocol.exits import ExitCode, RefusedError, S2RError

logger = logging.getLogger(__name__)

# Over the usual error of this object's manipulations: hardly to be bettered, and likely to be bettered by one more.
LUCKY, WORTH_A_TRY = 0.5, 1.5


def run_task(settings: RunSettings, journal: Journal, arguments: tuple[str, ...] = ()) -> RunRecord:
    """Run the whole loop. Never raises for what can go wrong on the way: the record says how it ended.

    Files in ``settings.out``: ``run.mcap`` and ``run.json``; the report is the caller's.
    """
    record = RunRecord(settings, journal, arguments)
    try:
        with journal.stage("connect") as stage:
            session = open_session(settings, journal)
            _introduce(record, session)
            stage.note = f"{record.arm_name} at {settings.executor}"
        with session:
            _loop(session, record)
    except KeyboardInterrupt:
        record.code, record.reason = (
            ExitCode.INTERRUPTED,
            "interrupted by the operator; the arm was stopped and is at rest",
        )
    except S2RError as error:
        record.code, record.reason = error.exit_code, str(error)
    except Exception as error:
        record.code, record.reason = ExitCode.BUG, f"{type(error).__name__}: {error}"
        logger.exception("the run ended with a bug")
    finally:
        record.write(settings.out / "run.json")
    return record


def _loop(session: Session, record: RunRecord) -> None:
    settings, journal, task = session.settings, session.journal, session.settings.task
    _warm_up(journal)
    _home(session, record)
    with journal.stage("view A") as stage:
        before = _look(session, record, "A")
        stage.note = f"{len(before.scene.p_base)} object points"
    found = _push_until_told(session, record, before)
    if found is None:
        record.code, record.reason = ExitCode.OK, "dry run: the first push is planned, nothing was moved"
        return
    estimate, after = found
    with journal.stage("build model") as stage:
        record.belief = build_belief(estimate, settings.out / "model", settings.seed)
        model = record.belief.model
        low, high = (task.unit.show(limit, 0) for limit in model.range)
        stage.note = f"{len(model.pieces)} pieces, range {low} to {high}"
        for text in model.warnings:
            journal.warn(text)
    record.s_found = float(estimate.delta)
    if settings.from_pushed:
        record.target = session.target = record.s_found + settings.target
    session.recorder.add_note(
        "joint", {"axis": estimate.axis_direction.tolist(), "s_after": float(estimate.delta)}
    )
    feeling = Feeling(session.arm, settings.out / "object-log", record.felt)
    _learn_from_push(session, record, feeling)
    _attempts(session, record, after, feeling)
    _judge(record)


def _learn_from_push(session: Session, record: RunRecord, feeling: Feeling) -> None:
    """The push that told the joint also tells how much it resists, and where the side is that was touched."""
    task, belief, push, s = session.settings.task, record.belief, record.push, record.s_found
    assert belief is not None
    assert push is not None
    assert s is not None
    if not push.went_through:
        return
    folder, positive = session.settings.out / "model-1", s > 0.0
    belief = _felt(session, feeling, belief, push.executed[PUSH], 0.0, s, folder)
    if not belief.template.slides and "touch" not in session.settings.without:
        touched = touched_by_push(
            belief, session.arm, push.planned.motion.push[-1], s, positive, task.far_off
        )
        if touched is not None:
            geom, offset = touched
            belief = corrected(belief, geom, offset, positive, folder)
            session.journal.say(
                f"the push touched {geom} {task.unit.show(-offset)} from where the model has it"
            )
    record.belief = belief


def _felt(
    session: Session,
    feeling: Feeling,
    belief: Belief,
    pushed: Executed,
    s_from: float,
    s_to: float,
    folder: Path,
) -> Belief:
    """The belief with what a motion made the arm feel of the part."""
    felt = feeling.feel(belief, session.executed, pushed, s_from, s_to)
    if not felt or "torque" in session.settings.without:
        return belief
    belief = with_felt(belief, feeling.touched, folder)
    if belief.felt is not None:
        effort, damping = ("N", "N·s/m") if belief.template.slides else ("N·m", "N·m·s/rad")
        session.journal.say(
            f"felt: friction {belief.felt.friction:.2f} {effort}, damping {belief.felt.damping:.2f} {damping}, "
            f"{belief.felt.mass_share:.2f} of the mass guessed"
        )
    return belief


def _push_until_told(
    session: Session, record: RunRecord, before: Observation
) -> tuple[JointEstimate, Observation] | None:
    """Push, look and estimate; where the views do not tell the joint, push again elsewhere. None in a dry run.

    Every estimate compares with the first view: what several pushes moved adds up.

    Raises:
        AbstainError: The last push told nothing either.
        NoMotionError: No further push is reachable.
    """
    settings, journal, task = session.settings, session.journal, session.settings.task
    view, skip = before, 0
    earlier: list[DonePush] = []
    positive: np.ndarray | None = None
    for number in range(1, settings.pushes + 1):
        again = "" if number == 1 else f" {number}"
        with journal.stage(f"first push{again}: proposals") as stage:
            planned = record.planned_push = prepare_push(session, view, number, skip, earlier)
            skip += planned.motion.tried
            positive = planned.positive if positive is None else positive
            stage.note = f"proposal {skip} is reachable"
        if settings.dry_run:
            return None
        with journal.stage(f"first push{again}"):
            record.push = carry_out_push(session, planned)
        with journal.stage(f"view B{again}") as stage:
            view = _look(session, record, f"B{number if again else ''}")
            stage.note = f"{len(view.scene.p_base)} object points"
        try:
            with journal.stage(f"estimate joint{again}") as stage:
                pushed = planned.motion.push_at_part if number == 1 else None
                estimate = estimate_part(before, view, task, positive, pushed, settings.seed)
                stage.note = (
                    f"moved {task.unit.show(estimate.delta)}, {100 * estimate.explained:.0f} % explained"
                )
        except (AbstainError, SceneError) as error:
            if number == settings.pushes:
                raise
            journal.warn(f"push {number} does not tell the joint, pushing again: {error}")
            earlier.append(replace(record.push, moved=not isinstance(error, NothingMovedError)))
            continue
        for text in estimate.warnings:
            journal.warn(text)
        return estimate, view
    raise AssertionError("settings.pushes is at least 1")


def _attempts(session: Session, record: RunRecord, view: Observation, feeling: Feeling) -> None:
    """Manipulate until the measured error is small enough or the attempts are used up."""
    settings, journal, task = session.settings, session.journal, session.settings.task
    assert record.belief is not None
    assert record.s_found is not None
    s_now = record.s_found
    for number in range(1, settings.attempts + 1):
        try:
            with journal.stage(f"plan {number}") as stage:
                planned = prepare_manipulation(session, record.belief, number, s_now, view)
                stage.note = (
                    f"{planned.result.control_steps} steps, {planned.delivery.trajectory.duration_s:.1f} s, "
                    f"ends at {task.unit.show(planned.foreseen)}"
                )
        except RefusedError as error:
            if number == 1:
                raise
            journal.warn(f"no correction {number}: {error}")
            return
        with journal.stage(f"manipulation {number}"):
            if settings.reactive:
                planned, executed = carry_out_reactively(session, record.belief, planned, view)
            else:
                executed = carry_out_manipulation(session, planned)
        with journal.stage(f"measure {number}") as stage:
            view, measured = measure_now(session, record.belief, f"C{number}", planned.foreseen)
            record.views.append(view)
            done = DoneManipulation(planned, executed, view, measured, s_now, session.target)
            record.attempts.append(done)
            stage.note = f"{task.unit.show(measured.s)}, δ {task.unit.show(done.delta)}"
        session.recorder.add_note(
            "state",
            {"number": number, "s": measured.s, "sigma": measured.sigma, "delta": done.delta},
        )
        folder, offset = settings.out / f"model-{number + 1}", measured.s - planned.foreseen
        if not planned.corrected:  # else the first motion was not all of it
            record.belief = _felt(session, feeling, record.belief, executed[0], s_now, measured.s, folder)
        if abs(done.delta) <= task.good_enough or _better_left_alone(
            record.attempts, task.tolerance, settings.attempts - number
        ):
            return
        s_now, learns = measured.s, "touch" not in settings.without
        if learns and number < settings.attempts and abs(offset) < task.far_off:
            positive = planned.request.s_target > planned.request.s_initial
            record.belief = corrected(record.belief, planned.pushed_geom, offset, positive, folder)
            journal.say(
                f"belief corrected: pushed side of {planned.pushed_geom} by {task.unit.show(-offset)}"
            )


def _better_left_alone(attempts: Sequence[DoneManipulation], tolerance: float, left: int) -> bool:
    """The part is within tolerance, and one more manipulation is likely to end worse.

    Manipulations of one object err alike. While several are left, a bad one is made good by the next; the last one
    is worth its risk only for an error well above the usual.
    """
    now = abs(attempts[-1].delta)
    usual = sum(abs(done.delta) for done in attempts) / len(attempts)
    return len(attempts) > 1 and now <= tolerance and now <= (LUCKY if left > 1 else WORTH_A_TRY) * usual


def _judge(record: RunRecord) -> None:
    last, task = record.attempts[-1], record.settings.task
    text = (
        f"{task.part} at {task.unit.show(last.measured.s)}, target {task.unit.show(last.s_target)}: "
        f"δ {task.unit.show(last.delta)} "
        f"after {len(record.attempts)} planned manipulation{'s' if len(record.attempts) > 1 else ''}"
    )
    good = abs(last.delta) <= task.tolerance
    record.code = ExitCode.OK if good else ExitCode.DIFFERENCE
    record.reason = text
    if not good:
        limit = task.unit.show(task.tolerance)[1:]
        record.reason = f"{text}, more than {limit}; look at the report's contact surfaces"


def _introduce(record: RunRecord, session: Session) -> None:
    arm = session.arm.arm
    record.identity = session.link.identity
    record.arm_name, record.model_hash, record.limit_hash = arm.name, arm.model_hash, arm.limit_hash


def _warm_up(journal: Journal) -> None:
    """Import the heavy libraries now: an import holds the interpreter for a second, a heartbeat may not wait."""
    with journal.stage("load libraries"):
        import toppra  # noqa: F401


def _home(session: Session, record: RunRecord) -> None:
    with session.journal.stage("home") as stage:
        q_home = session.arm.arm.q_home
        if abs(session.status().q_ref - q_home).max() < 1e-3:
            stage.note = "already there"
            return
        view = _look(session, record, "start")
        obstacles = [table_obstacle(), cloud_obstacle(view.scene.p_base, view.scene.p_camera)]
        go_to(session, q_home, obstacles, "home")


def _look(session: Session, record: RunRecord, name: str) -> Observation:
    view = observe(session, name)
    record.views.append(view)
    record.world_commitment = record.world_commitment or view.capture.world_commitment or None
    return view
