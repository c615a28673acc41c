"""The order of a run, and how it ends: well, refused, stopped or interrupted, always with files to read."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace

from s2r_host.errors import CommandRefusedError
from s2r_host.link_types import LATCHED
from s2r_host.motion.obstacles import cloud_obstacle, table_obstacle
from s2r_host.run.ask import ask_operator
from s2r_host.run.belief import build_belief
from s2r_host.run.dry_run import planned_where_it_stands, stay
from s2r_host.run.feeling import Feeling
from s2r_host.run.journal import Journal
from s2r_host.run.lessons import learn_from_push
from s2r_host.run.measure_view import state_if_seen, state_in
from s2r_host.run.observe import Observation, observe
from s2r_host.run.push_until_told import Told, push_until_told
from s2r_host.run.reach import reach
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.run_json import write_run_json
from s2r_host.run.session import Session, open_session
from s2r_host.run.settings import RunSettings
from s2r_host.run.travel import at_home, go_to, leave_touch
from s2r_protocol.exits import ExitCode, RefusedError, S2RError
from s2r_protocol.faults import Refusal
from s2r_protocol.whole_file import NO_ROOM

logger = logging.getLogger(__name__)


def run_task(
    settings: RunSettings,
    journal: Journal,
    arguments: tuple[str, ...] = (),
    ask: Callable[[RunRecord], float] = ask_operator,
) -> RunRecord:
    """Run the whole loop. Never raises for what can go wrong on the way: the record says how it ended.

    Files in ``settings.out``: ``run.mcap`` and ``run.json``; the report is the caller's.

    Args:
        settings, journal: Of the run.
        arguments: Command line, for the record.
        ask: Tells the first target [m or rad], counted as ``settings.target``, where the settings leave it open.
    """
    record = RunRecord(settings, journal, arguments)
    session: Session | None = None
    try:
        with ExitStack() as links:
            with journal.stage("connect") as stage:
                session = links.enter_context(open_session(settings, journal))
                _introduce(record, session)
                _refuse_latched(session)
                stage.note = f"{record.arm_name} at {settings.executor}"
            _loop(session, record, ask)
    except KeyboardInterrupt:
        rest = session.rest if session else "nothing was moved"
        record.code, record.reason = ExitCode.INTERRUPTED, f"interrupted by the operator; {rest}"
    except S2RError as error:
        record.code, record.reason = error.exit_code, f"{_reached(record)}{error}"
    except Exception as error:
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            rest = session.rest if session else "nothing was moved"
            full = f"{error.filename or settings.out}: {error.strerror}; make room, or name another disk with --out"
            record.code, record.reason = ExitCode.NOT_READY, f"{_reached(record)}{full}; {rest}"
        else:
            record.code, record.reason = ExitCode.BUG, f"{type(error).__name__}: {error}"
            logger.exception("the run ended with a bug")
    finally:
        _keep(record)
    return record


def _keep(record: RunRecord) -> None:
    """Write ``run.json``; where the disk takes no more the record, which is told on the terminal, says so as well."""
    record.ended = True
    try:
        write_run_json(record)
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        record.code = record.code or ExitCode.NOT_READY
        record.reason += f"; no run.json is left: {error.strerror}"


def _loop(session: Session, record: RunRecord, ask: Callable[[RunRecord], float]) -> None:
    settings, journal = session.settings, session.journal
    with planned_where_it_stands(session):
        _home(session, record)
        with journal.stage("view A") as stage:
            before = record.add_view(observe(session, "A"))
            stage.note = f"{len(before.scene.p_base)} object points"
        told = push_until_told(session, record, before)
    if told is None:
        record.code, record.reason = ExitCode.OK, f"dry run: the first push is planned, {session.rest}"
        return
    _believe(session, record, before, told)
    feeling = Feeling(session.arm, settings.out / "object-log", record.felt)
    learn_from_push(session, record, feeling, told)
    first = settings.target
    if first is None:
        write_run_json(record)  # what is believed so far, for whoever is asked
        first = record.target_told = ask(record)
    _to_targets(session, record, feeling, told.after, (first, *settings.then))


def _believe(session: Session, record: RunRecord, first: Observation, told: Told) -> None:
    """Build the object that the pushes told; say from which views its joint values and the targets count."""
    settings, journal = session.settings, session.journal
    record.told_by_push, record.push_seen_from = told.estimate, told.before.name
    with journal.stage("build model") as stage:
        record.belief = build_belief(told.estimate, settings.out / "model", settings.seed)
        model = record.belief.model
        record.zero_view, record.s_found = told.before.name, float(told.estimate.delta)
        record.told_view = record.found_view = told.after.name
        if settings.from_pushed:
            record.s_first = state_if_seen(record.belief, first, told.before)
            record.origin_view, record.origin = told.after.name, record.s_found
        else:
            record.s_first = record.origin = state_in(record.belief, first, told.before)
            record.origin_view = first.name
        low, high = (record.show(limit, 0) for limit in model.range)
        stage.note = f"{len(model.pieces)} pieces, range {low} to {high}"
        for text in model.warnings:
            journal.warn(text)
    session.recorder.add_note(
        "joint", {"axis": told.estimate.axis_direction.tolist(), "s_after": record.s_found}
    )


def _to_targets(
    session: Session, record: RunRecord, feeling: Feeling, view: Observation, targets: Sequence[float]
) -> None:
    """Move the part to one target after the other, and learn in between.

    Args:
        session: Links.
        record: With the belief; gets the goals and the outcome.
        feeling: What the arm feels of the part.
        view: The newest look.
        targets: As the command line counts them [m or rad].
    """
    settings, journal, task = session.settings, session.journal, session.settings.task
    assert record.s_found is not None
    s_now, asks_gap = record.s_found, settings.learn_physics and "gap" not in settings.without
    for number, target in enumerate(targets, start=1):
        session.target = record.origin + target
        record.goals.append(Goal(session.target, s_before=s_now))
        if abs(session.target - s_now) <= task.good_enough:
            _judge(record)
            journal.say(f"nothing to do: {record.reason}")
            _learn_between(session, record, number, len(targets))
            continue
        if asks_gap:
            from s2r_host.run.physics import before_target  # loads the gap tool

            before_target(session, record)
        moved_before = len(session.executed)
        try:
            view = reach(session, record, feeling, view, s_now)
        except RefusedError as error:
            if not settings.go_on or len(session.executed) > moved_before:  # where the part is was not seen
                raise
            record.goals[-1] = replace(record.goals[-1], refused=str(error))
            _judge(record)
            journal.warn(f"going on without this target: {error}")
            _learn_between(session, record, number, len(targets))
            continue
        s_now = record.goals[-1].last.measured.s
        if not _judge(record) and not settings.go_on:
            return
        _learn_between(session, record, number, len(targets))


def _learn_between(session: Session, record: RunRecord, number: int, last: int) -> None:
    """What the motions so far teach about the part, for the targets that follow a target, moved to or not; numbers
    count from 1."""
    settings = session.settings
    if not settings.learn_physics or number >= last:
        return
    from s2r_host.run.lost_motion import learn_lost_motion
    from s2r_host.run.physics import after_target
    from s2r_host.run.weighed import weigh_newest

    if "gap" not in settings.without and after_target(session, record, number):
        weigh_newest(session, record)
    if record.goals[-1].attempts:
        learn_lost_motion(session, record)


def _judge(record: RunRecord) -> bool:
    """Whether the newest target was reached; the record's code and reason tell about all of them."""
    task, told = record.settings.task, []
    for goal in record.goals:
        count = len(goal.attempts)
        if goal.refused:
            told.append(f"target {record.show(goal.target)} was left out: {goal.refused}")
            continue
        if not count:
            told.append(
                f"{task.part} at {record.show(goal.s_before)} already, target {record.show(goal.target)}"
            )
            continue
        told.append(
            f"{task.part} at {record.show(goal.last.measured.s)}, target {record.show(goal.target)}: "
            f"δ {task.unit.show(goal.last.delta)} after {count} planned manipulation{'s' if count > 1 else ''}"
        )
    missed = [goal for goal in record.goals if goal.attempts and not abs(goal.last.delta) <= task.tolerance]
    refused = any(goal.refused for goal in record.goals)
    record.code = ExitCode.REFUSED if refused else ExitCode.DIFFERENCE if missed else ExitCode.OK
    record.reason, newest = "; then ".join(told), record.goals[-1]
    limit = task.unit.show(task.tolerance)[1:]
    if newest in missed:
        record.reason += f", more than {limit}; look at the report's contact surfaces"
    elif missed:
        record.reason += f"; {len(missed)} of {len(record.goals)} targets missed by more than {limit}"
    return newest not in missed and not newest.refused


def _reached(record: RunRecord) -> str:
    """What to say of earlier targets before the reason why a later one was not reached."""
    done = sum(bool(goal.attempts) for goal in record.goals[:-1])
    return f"after {done} of {1 + len(record.settings.then)} targets: " if done else ""


def _introduce(record: RunRecord, session: Session) -> None:
    arm = session.arm.arm
    record.identity = session.link.identity
    record.arm_name, record.model_hash, record.limit_hash = arm.name, arm.model_hash, arm.limit_hash


def _refuse_latched(session: Session) -> None:
    """A fault that was there before the run: looking and planning would be in vain.

    Raises:
        CommandRefusedError: The executor would not arm.
    """
    status = session.status()
    if status.state in LATCHED and not session.settings.dry_run:
        raise CommandRefusedError(
            f"the arm cannot move, the executor is {status.state.name}: {status.why_not_moving}",
            Refusal.STATE,
        )


def _home(session: Session, record: RunRecord) -> None:
    with session.journal.stage("home") as stage:
        session.link.wait_for_drives()
        if at_home(session):
            stage.note = "already there"
            return
        view = record.add_view(observe(session, "start"))
        obstacles = [table_obstacle(), cloud_obstacle(view.scene.p_base, view.scene.p_camera)]
        if session.settings.dry_run:
            stage.note = stay(session, obstacles)
            return
        leave_touch(session, view, obstacles)
        go_to(session, session.arm.arm.q_home, obstacles, "home")
