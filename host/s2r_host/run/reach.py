"""To one target: plan, manipulate, measure, correct, until it is good enough or better left alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.run.contact import corrected
from s2r_host.run.feeling import Feeling
from s2r_host.run.lessons import belief_with_felt
from s2r_host.run.manipulate import DoneManipulation, carry_out_manipulation
from s2r_host.run.measure_view import measure_in
from s2r_host.run.observe import Observation, observe
from s2r_host.run.planned import PlannedManipulation
from s2r_host.run.prepare import prepare_manipulation
from s2r_host.run.reactive import StrandedError, carry_out_reactively
from s2r_host.run.record import RunRecord
from s2r_host.run.run_json import finite
from s2r_host.run.session import Executed, Session
from s2r_host.run.task import Task
from s2r_host.run.tell_again import tell_again, tell_lost
from s2r_protocol.exits import RefusedError

# Over the usual error of this object's manipulations: hardly to be bettered, and likely to be bettered by one more.
LUCKY, WORTH_A_TRY = 0.5, 1.5
# Standard errors of the measurement, and times what is good enough, below both of which a difference may be its own.
UNSURE, NEARLY = 2.5, 1.5
HELD_UP = 3  # times that a part has to be stopped at one place to be at the end of its way


def reach(
    session: Session, record: RunRecord, feeling: Feeling, view: Observation, s_now: float
) -> Observation:
    """Manipulate until the session's target is reached well enough or the attempts are used up.

    Args:
        session: Links and the target.
        record: Its newest goal gets the manipulations, and it the belief as they teach it.
        feeling: What the arm feels of the part.
        view: The newest look.
        s_now: Where the part is, by that look [m or rad].

    Returns:
        The look after the last manipulation.

    Raises:
        RefusedError: No plan for the first manipulation; without one for a correction it is left out.
        StrandedError: A manipulation went through, but there is no way home; it is kept where the part is seen.
    """
    settings, journal, task = session.settings, session.journal, session.settings.task
    assert record.belief is not None
    goal = record.goals[-1]
    for left in reversed(range(settings.attempts)):
        number = len(record.attempts) + 1
        try:
            with journal.stage(f"plan {number}") as stage:
                planned = prepare_manipulation(session, record.belief, number, s_now, view, record.show)
                stage.note = (
                    f"{planned.result.control_steps} steps, {planned.delivery.trajectory.duration_s:.1f} s, "
                    f"ends at {record.show(planned.foreseen)}"
                )
        except RefusedError as error:
            if not goal.attempts:
                raise
            journal.warn(f"no correction {number}: {error}")
            return view
        try:
            with journal.stage(f"manipulation {number}"):
                if settings.reactive:
                    planned, executed = carry_out_reactively(session, record.belief, planned, view)
                else:
                    planned, executed = carry_out_manipulation(session, planned)
        except StrandedError as error:
            _keep_stranded(session, record, error, s_now)
            raise
        done, lost = _measured(session, record, planned, executed, view, s_now)
        view, measured, goal = done.view, done.measured, record.goals[-1]
        _keep(session, record, done)
        folder, offset = settings.out / f"model-{number + 1}", measured.s - done.foreseen
        anew = lost or tell_again(session, record, view)
        if anew:
            feeling.tell_anew(record.belief, _moved_so_far(record))
            goal = record.goals[-1]
            done = goal.last
        # Of a corrected one the first motion was not all of it; what is felt of a part that stays is something else.
        if not planned.corrected and not _in_vain(done, task):
            record.belief = belief_with_felt(
                session, feeling, record.belief, executed[0], done.s_initial, done.measured.s, folder
            )
        if _there(done, task) or _better_left_alone(goal.attempts, task.tolerance, left):
            return view
        if _held_up(goal.attempts, task.good_enough):
            journal.warn(
                f"the {task.part} was stopped {HELD_UP} times at {record.show(done.measured.s)}: it seems to be "
                "at the end of its way, or something is in it; try another target"
            )
            return view
        positive = done.s_target > done.s_initial
        if not anew and (_in_vain(done, task) or _stopped_short(done, task)):
            record.belief = record.belief.with_missed(positive, planned.result.p_part)
            what = "arm was stopped on the way" if planned.stopped else f"{task.part} stayed"
            journal.say(
                f"the {what}: next time the {task.part} is pushed from elsewhere, if anything else does"
            )
        s_now, learns = done.measured.s, "touch" not in settings.without and not anew
        lesson = _lesson(offset, task.far_off, positive=positive)
        if learns and left and not planned.stopped and lesson:
            taught = corrected(record.belief, planned.end.geom, lesson, positive, folder)
            record.belief = taught.with_proven(positive, planned.result.p_part)
            journal.say(f"belief corrected: pushed side of {planned.end.geom} by {task.unit.show(-lesson)}")
        if record.lessons and left:
            from s2r_host.run.physics import brake_at_target  # loads the gap tool

            brake_at_target(session, record, s_now)
    return view


def _moved_so_far(record: RunRecord) -> dict[str, tuple[float, float]]:
    """Where the manipulations before the newest one began and ended, by the label of the motion that pushed."""
    earlier = [done for done in record.attempts[:-1] if done.executed and not done.planned.corrected]
    return {done.executed[0].label: (done.s_initial, done.measured.s) for done in earlier}


def _keep(session: Session, record: RunRecord, done: DoneManipulation) -> None:
    number, measured = len(record.attempts) + 1, done.measured
    record.goals[-1].attempts.append(done)
    session.recorder.add_note(
        "state",
        {"number": number, "s": measured.s, "sigma": finite(measured.sigma), "delta": done.delta},
    )


def _keep_stranded(session: Session, record: RunRecord, error: StrandedError, s_now: float) -> None:
    """Keep a manipulation after which the arm stays beside the part, if the camera sees the part behind it.

    No joint is told anew from there: a part that is not where it was believed to be may be no more than hidden.
    """
    assert record.belief is not None
    journal, number = session.journal, len(record.attempts) + 1
    since_told = record.origin_view == record.told_view
    try:
        with journal.stage(f"measure {number}") as stage:
            view = record.add_view(observe(session, f"C{number}"))
            measured = measure_in(record.belief, view, error.planned.foreseen, since_told=since_told)
            done = DoneManipulation(error.planned, error.executed, view, measured, s_now, session.target)
            stage.note = f"{record.show(measured.s)}, δ {session.settings.task.unit.show(done.delta)}"
    except RefusedError as unseen:
        journal.warn(f"where manipulation {number} has left the part is not seen past the arm: {unseen}")
        return
    _keep(session, record, done)


def _measured(
    session: Session,
    record: RunRecord,
    planned: PlannedManipulation,
    executed: tuple[Executed, ...],
    before: Observation,
    s_now: float,
) -> tuple[DoneManipulation, bool]:
    """Look, and fit the part's state; where the joint believed does not let it be where it is, that is told anew.

    Returns:
        The manipulation with what came of it, and whether the joint is another one since.

    Raises:
        EmptyCloudError, SceneError: The part is not seen, and no other joint tells where it went.
    """
    journal, number, problem = session.journal, len(record.attempts) + 1, ""
    belief, since_told = record.belief, record.origin_view == record.told_view
    assert belief is not None
    with journal.stage(f"measure {number}") as stage:
        view = record.add_view(observe(session, f"C{number}"))
        try:
            measured = measure_in(belief, view, planned.foreseen, since_told=since_told)
        except SceneError as error:
            stage.note = problem = str(error)
        else:
            done = DoneManipulation(planned, executed, view, measured, s_now, session.target)
            stage.note = f"{record.show(measured.s)}, δ {session.settings.task.unit.show(done.delta)}"
            return done, False
    told = tell_lost(session, record, before, view)
    if told is None:
        raise SceneError(problem)
    goal = record.goals[-1]
    s_initial = goal.last.measured.s if goal.attempts else goal.s_before
    shift = s_initial - s_now
    return DoneManipulation(planned, executed, view, told, s_initial, session.target, shift), True


def _there(done: DoneManipulation, task: Task) -> bool:
    """The part is where it should be, or no measurement of this view tells that it is not.

    A lid seen edge-on is measured to a degree. Corrections of less than that chase the measurement's own error.
    """
    sigma = done.measured.sigma
    told = UNSURE * sigma if np.isfinite(sigma) else 0.0
    return abs(done.delta) <= max(task.good_enough, min(told, NEARLY * task.good_enough))


def _better_left_alone(attempts: Sequence[DoneManipulation], tolerance: float, left: int) -> bool:
    """The part is within tolerance, and one more manipulation is likely to end worse.

    Manipulations of one object err alike. While several are left, a bad one is made good by the next; the last one
    is worth its risk only for an error well above the usual. One that went far astray, or was stopped on its way, is no
    measure of the next.
    """
    now = abs(attempts[-1].delta)
    ends = [min(abs(done.delta), tolerance) for done in attempts if not done.planned.stopped]
    usual = sum(ends) / max(len(ends), 1)
    return len(ends) > 1 and now <= tolerance and now <= (LUCKY if left > 1 else WORTH_A_TRY) * usual


def _lesson(offset: float, far_off: float, *, positive: bool) -> float:
    """By how much the pushed side is to be moved, for the part ended ``offset`` beyond where it was foreseen.

    One that ended far short has slipped off the fingertip, which says nothing about its side. One that ended far beyond
    went on by itself, as it will next time.
    """
    if abs(offset) < far_off:
        return offset
    beyond = (offset > 0.0) == positive
    return float(np.copysign(far_off, offset)) if beyond else 0.0


def _in_vain(done: DoneManipulation, task: Task) -> bool:
    """The part was to be moved far and stayed: the fingertip met nothing, or something that does not give way."""
    far = abs(done.s_target - done.s_initial) > task.far_off
    return far and abs(done.measured.s - done.s_initial) < task.good_enough


def _stopped_short(done: DoneManipulation, task: Task) -> bool:
    """A protection stopped the arm before the part was where it was to be: something unseen is on this way."""
    return done.planned.stopped and abs(done.measured.s - done.foreseen) > task.far_off


def _held_up(attempts: Sequence[DoneManipulation], same: float) -> bool:
    """Three manipulations in a row were stopped on the same way and left the part at the same place.

    Two may have met the same other thing, or wedged the fingertip; after the second, in vain, it is pushed from
    elsewhere.
    """
    last = attempts[-HELD_UP:]
    if len(last) < HELD_UP:
        return False
    same_way = all(
        (last[0].s_target - last[0].s_initial) * (one.s_target - one.s_initial) > 0.0 for one in last
    )
    same_place = all(abs(one.measured.s - last[0].measured.s) < same for one in last)
    return same_way and same_place and all(one.planned.stopped for one in last)
