"""A planned manipulation that is corrected while it runs, from what the camera sees: ``s2r run --reactive``."""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from s2r_host.errors import ArmStoppedError, NoMotionError
from s2r_host.link import Verdict
from s2r_host.planning.planner import scene_of
from s2r_host.run.back_off import back_off
from s2r_host.run.belief import Belief
from s2r_host.run.live_joint import LiveJoint
from s2r_host.run.observe import Observation
from s2r_host.run.planned import ManipulationEnd, PlannedManipulation, way_home
from s2r_host.run.session import Executed, Motion, Sent, Session
from s2r_host.trajectory import Trajectory
from s2r_host.trajectory.reactive import ReactivePlanner
from s2r_host.trajectory.reactive_run import ReactiveReport, follow_reactively

logger = logging.getLogger(__name__)


class StrandedError(NoMotionError):
    """No way home from where a corrected motion ended.

    Attributes:
        planned: What was played, as :func:`carry_out_reactively` returns it.
        executed: What was sent.
    """

    def __init__(self, text: str, planned: PlannedManipulation, executed: tuple[Executed, ...]) -> None:
        super().__init__(text)
        self.planned, self.executed = planned, executed


@dataclass(frozen=True, eq=False)
class _Played:
    """A motion, and when it took over from the one before, in that one's time [s]; infinite: that one was at rest."""

    trajectory: Trajectory
    splice_t: float = math.inf


def carry_out_reactively(
    session: Session, belief: Belief, planned: PlannedManipulation, view: Observation
) -> tuple[PlannedManipulation, tuple[Executed, ...]]:
    """Execute the manipulation with an eye on the part, then the way out and home from where it ended.

    Args:
        session: Links.
        belief: About the object.
        planned: What to begin with.
        view: The look at the part before it.

    Returns:
        What was played, with the joint value that the model foresees for it, and what was executed.

    Raises:
        ArmStoppedError: As :func:`carry_out_manipulation`.
        PeerUnreachableError: As :func:`follow_reactively`.
        StrandedError: No way home from where a corrected motion ended; the arm is at rest there.
    """
    request, begun = planned.request, len(session.executed)
    scene = scene_of(request)
    planner = ReactivePlanner(request, scene, planned.result.hook, yields=planned.end.yields)
    feed = LiveJoint(session, belief, view, request.s_initial)
    if not feed.known:
        why = f" ({feed.problem})" if feed.problem else ""
        session.journal.warn(
            f"the part cannot be followed from the view before it moves{why}: the plan is played unseen"
        )
    played = [_Played(planned.motions[0].trajectory)]
    report: ReactiveReport | None = None

    def play(sent: list[Sent]) -> None:
        nonlocal report

        def note(trajectory: Trajectory, label: str, verdict: Verdict, splice_t: float) -> None:
            if sent:
                _close(session, sent[-1])
                played.append(_Played(trajectory, splice_t))
            sent.append(session.note_sent(Motion(trajectory, label), verdict, session.status().tick))

        def forget() -> None:
            sent.pop()
            played.pop()

        first = planned.motions[0]
        try:
            report = follow_reactively(
                session.link,
                feed,
                planner,
                first.trajectory,
                label=first.label,
                sent=note,
                given_up=forget,
            )
        finally:
            if sent:
                _close(session, sent[-1])

    try:
        with feed:
            session.play(play)
    except ArmStoppedError as error:
        _tell_problem(session, feed)
        back_off(session, error, _way_in(played), f"{planned.motions[0].label}: backing off")
        # Once another motion has taken over, the first one is not all of what moved the part.
        planned = replace(planned, stopped=True, corrected=len(played) > 1)
        return planned, tuple(session.executed[begun:])
    assert report is not None
    _tell(session, feed, report, planned.end.yields)
    planned = _as_played(planned, report)
    try:
        home = planned.motions[1:] if len(played) == 1 else _other_way_home(session, belief, planned, view)
    except NoMotionError as error:
        text = f"{error}; the arm is at rest where manipulation {planned.number} ended"
        raise StrandedError(text, planned, tuple(session.executed[begun:])) from error
    session.move(home)
    return planned, tuple(session.executed[begun:])


def _way_in(played: Sequence[_Played]) -> np.ndarray:
    """The joint path that motions made one after another, (n, dof) [rad].

    What lay behind a splice was never played. The arm was not there, and it may lead into what it was stopped by.
    """
    rows: list[np.ndarray] = []
    for one, following in itertools.pairwise(played):
        motion, until_t = one.trajectory, min(following.splice_t, one.trajectory.duration_s)
        rows += [motion.q[motion.t <= until_t], motion.sample(until_t)[0][None]]
    return np.vstack([*rows, played[-1].trajectory.q])


def _close(session: Session, sent: Sent) -> None:
    sent.wall_s = session.journal.elapsed_s - sent.begun_s


def _other_way_home(
    session: Session, belief: Belief, planned: PlannedManipulation, view: Observation
) -> tuple[Motion, ...]:
    """Out of contact and home from where a corrected motion ended."""
    replay, moving = planned.delivery.replay, session.settings.task.moving
    touched = int(np.argmax(np.abs(replay.s - planned.request.s_initial) > moving))
    end = ManipulationEnd(session.status().q_ref, planned.foreseen, replay.q_meas[:touched])
    return way_home(session, belief, planned.request, planned.number, view, end)[1]


def _as_played(planned: PlannedManipulation, report: ReactiveReport) -> PlannedManipulation:
    """The manipulation with the end that the model, as it was before, foresees for what was played."""
    if not report.spliced + report.restarted or not report.outlooks:
        return planned
    last = report.outlooks[-1]
    end = last.new_end if report.played[-1][0] is last.motion else last.running_end
    final = end - last.offset
    replay = replace(planned.delivery.replay, final=final, error=planned.request.s_target - final)
    return replace(planned, delivery=replace(planned.delivery, replay=replay), corrected=True)


def _tell(session: Session, feed: LiveJoint, report: ReactiveReport, yields: float) -> None:
    """Say what the looks came to. A part that goes ``yields`` [m or rad] further than its model is not beside it."""
    unit, counts = session.settings.task.unit, feed.counts
    rate = f"{report.rate_hz:.1f} per second" if report.rate_hz is not None else "too few for a rate"
    frames = counts.seen + counts.lost + counts.undated
    offset = report.outlooks[-1].offset - yields if report.outlooks else 0.0
    session.journal.say(
        f"looked ahead {len(report.outlooks)} times ({rate}), {frames} frames ({counts.lost} without the part, "
        f"{counts.undated} of an unknown moment): "
        f"{report.spliced} corrections on the way, {report.restarted} from rest, {len(report.refused)} refused; "
        f"the part stands {unit.show(offset)} beside its model"
    )
    for text in report.refused:
        session.journal.say(f"correction refused: {text}")
    _tell_problem(session, feed)
    cpu_ms = [1e3 * look.cpu_s for look in report.outlooks]
    session.recorder.add_note(
        "reactive",
        {
            "looks": len(report.outlooks),
            "rate_hz": report.rate_hz,
            "look_cpu_ms": [float(np.median(cpu_ms)), max(cpu_ms)] if cpu_ms else None,
            "frames": frames,
            "frame_s": counts.frame_s / frames if frames else None,
            "lost": counts.lost,
            "undated": counts.undated,
            "spliced": report.spliced,
            "restarted": report.restarted,
            "refused": report.refused,
            "offset": offset,
        },
    )


def _tell_problem(session: Session, feed: LiveJoint) -> None:
    if feed.known and feed.problem:
        session.journal.warn(
            f"the part was not followed to the end, the plan was played on unseen: {feed.problem}"
        )
