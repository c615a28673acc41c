"""The order of a run, and how it ends: well, refused, stopped or interrupted, always with files to read."""

from __future__ import annotations

import logging

from s2r_host.motion.obstacles import cloud_obstacle, table_obstacle
from s2r_host.run.belief import build_belief, corrected, estimate_slide
from s2r_host.run.first_push import carry_out_push, prepare_push
from s2r_host.run.journal import Journal
from s2r_host.run.manipulate import (
    DoneManipulation,
    carry_out_manipulation,
    measure_now,
    prepare_manipulation,
)
from s2r_host.run.observe import Observation, observe
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Session, open_session
from s2r_host.run.settings import RunSettings
from s2r_host.run.travel import go_to
from s2r_protocol.exits import ExitCode, RefusedError, S2RError

logger = logging.getLogger(__name__)

FAR_OFF_M = 0.02


def run_drawer(settings: RunSettings, journal: Journal, arguments: tuple[str, ...] = ()) -> RunRecord:
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
    settings, journal = session.settings, session.journal
    _warm_up(journal)
    _home(session, record)
    with journal.stage("view A") as stage:
        before = _look(session, record, "A")
        stage.note = f"{len(before.scene.p_base)} object points"
    with journal.stage("first push: proposals") as stage:
        record.planned_push = prepare_push(session, before)
        stage.note = f"proposal {record.planned_push.motion.tried} is reachable"
    if settings.dry_run:
        record.code, record.reason = ExitCode.OK, "dry run: the first push is planned, nothing was moved"
        return
    with journal.stage("first push"):
        record.push = carry_out_push(session, record.planned_push)
    with journal.stage("view B") as stage:
        after = _look(session, record, "B")
        stage.note = f"{len(after.scene.p_base)} object points"
    with journal.stage("estimate joint") as stage:
        estimate = estimate_slide(before, after, record.planned_push.front.normal, settings.seed)
        stage.note = f"moved {1e3 * estimate.delta:+.1f} mm, {100 * estimate.explained:.0f} % explained"
        for text in estimate.warnings:
            journal.warn(text)
    with journal.stage("build model") as stage:
        record.belief = build_belief(estimate, settings.out / "model", settings.seed)
        model = record.belief.model
        stage.note = f"{len(model.pieces)} pieces, range {model.range[0]:+.3f} to {model.range[1]:+.3f} m"
        for text in model.warnings:
            journal.warn(text)
    record.s_found = float(estimate.delta)
    session.recorder.add_note(
        "joint", {"axis": estimate.axis_direction.tolist(), "s_after_m": float(estimate.delta)}
    )
    _attempts(session, record, after)
    _judge(record)


def _attempts(session: Session, record: RunRecord, view: Observation) -> None:
    """Manipulate until the measured error is small enough or the attempts are used up."""
    settings, journal = session.settings, session.journal
    assert record.belief is not None
    assert record.s_found is not None
    s_now = record.s_found
    for number in range(1, settings.attempts + 1):
        try:
            with journal.stage(f"plan {number}") as stage:
                planned = prepare_manipulation(session, record.belief, number, s_now, view)
                stage.note = (
                    f"{planned.result.control_steps} steps, {planned.delivery.trajectory.duration_s:.1f} s, "
                    f"ends at {planned.foreseen_m:+.4f} m"
                )
        except RefusedError as error:
            if number == 1:
                raise
            journal.warn(f"no correction {number}: {error}")
            return
        with journal.stage(f"manipulation {number}"):
            executed = carry_out_manipulation(session, planned)
        with journal.stage(f"measure {number}") as stage:
            view, measured = measure_now(session, record.belief, f"C{number}", planned.foreseen_m)
            record.views.append(view)
            done = DoneManipulation(planned, executed, view, measured, s_now, settings.target_m)
            record.attempts.append(done)
            stage.note = f"{measured.s_m:+.4f} ± {measured.sigma_m:.4f} m, delta {1e3 * done.delta_m:+.2f} mm"
        session.recorder.add_note(
            "state",
            {"number": number, "s_m": measured.s_m, "sigma_m": measured.sigma_m, "delta_m": done.delta_m},
        )
        if abs(done.delta_m) <= settings.good_enough_m:
            return
        s_now = measured.s_m
        offset = measured.s_m - planned.foreseen_m
        if number < settings.attempts and abs(offset) < FAR_OFF_M:
            folder = settings.out / f"model-{number + 1}"
            pushed_out = planned.request.s_target > planned.request.s_initial
            record.belief = corrected(record.belief, planned.pushed_geom, offset, pushed_out, folder)
            journal.say(f"belief corrected: pushed face of {planned.pushed_geom} by {-1e3 * offset:+.1f} mm")


def _judge(record: RunRecord) -> None:
    last, tolerance = record.attempts[-1], record.settings.tolerance_m
    text = (
        f"drawer at {last.measured.s_m:+.4f} m, target {last.s_target:+.4f} m: delta {1e3 * last.delta_m:+.2f} mm "
        f"after {len(record.attempts)} planned manipulation{'s' if len(record.attempts) > 1 else ''}"
    )
    good = abs(last.delta_m) <= tolerance
    record.code = ExitCode.OK if good else ExitCode.DIFFERENCE
    record.reason = (
        text if good else f"{text}, more than {1e3 * tolerance:.1f} mm; look at the report's contact surfaces"
    )


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
