"""Send a recorded plan again: to where it begins, through the same admission, then compare.

The way to the plan's start is a recorded one or a move that is checked against arm and table. From there on to a later
time of the plan (``ReplaySettings.t_start``) only the plan itself knows the way: the fingertip is behind a handle or at
a lid then, of which no such check knows.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.link import ExecutorLink
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.collision import CollisionChecker
from s2r_host.motion.joint_motion import plan_joint_motion
from s2r_host.motion.obstacles import Obstacle, table_obstacle
from s2r_host.recording import JointTrack, plan_track
from s2r_host.replay.pace import from_time, path_time, slowed, until_time
from s2r_host.replay.sources import Replayable
from s2r_host.replay.way import JOINED_RAD, joined, missing_of, recorded_way
from s2r_host.trajectory import TimeLawSettings, Trajectory, time_law
from s2r_protocol.faults import ExecutorState

logger = logging.getLogger(__name__)

AT_START_RAD = 1e-4
TRAVEL_SPEED = 0.5


@dataclass(frozen=True)
class ReplaySettings:
    """How to replay.

    Attributes:
        speed: Share of the recorded speed, in (0, 1].
        t_start: Begin at this time of the plan [s], after the plan's own way there where the arm stands elsewhere.
        step_s: Pause after each so much of plan time [s]; 0 = do not.
        next_step: Called at each pause; False ends the replay with a stop.
    """

    speed: float = 1.0
    t_start: float = 0.0
    step_s: float = 0.0
    next_step: Callable[[float], bool] = lambda t: True


@dataclass(frozen=True, eq=False)
class Comparison:
    """Executions of one plan, sampled at the same plan times.

    Attributes:
        t: Plan times all recordings cover [s], shape (n,).
        q_planned, q_first, q_again: [rad], shape (n, dof). Without a first execution it is the plan.
    """

    t: np.ndarray
    q_planned: np.ndarray
    q_first: np.ndarray
    q_again: np.ndarray

    @property
    def rms_rad(self) -> np.ndarray:
        """Root mean square of again minus first, per joint, shape (dof,)."""
        return np.sqrt(((self.q_again - self.q_first) ** 2).mean(axis=0))

    @property
    def largest_rad(self) -> np.ndarray:
        """Largest magnitude of again minus first, per joint, shape (dof,)."""
        return np.abs(self.q_again - self.q_first).max(axis=0)


@dataclass(frozen=True, eq=False)
class Replayed:
    """A plan that was sent again, once.

    Attributes:
        plan: Which.
        seq: Its number at the executor.
        recording: The executor's (MCAP).
        comparison: With its first execution.
        left_out: Plans that ran before it and were not sent again, though the world was as the recording found it: what
            they did to the object is missing.
    """

    plan: Replayable
    seq: int
    recording: bytes
    comparison: Comparison
    left_out: tuple[Replayable, ...] = ()


@dataclass(frozen=True, eq=False)
class Repeatability:
    """Several replays of one plan: spread of the measured joints about their mean.

    Attributes:
        t: [s], shape (n,).
        q: Measured [rad], shape (replays, n, dof).
    """

    t: np.ndarray
    q: np.ndarray
    names: tuple[str, ...] = field(default=())

    @property
    def sigma_rad(self) -> np.ndarray:
        """Standard deviation over the replays, root mean square over time, per joint, shape (dof,)."""
        return np.sqrt(self.q.var(axis=0, ddof=1).mean(axis=0))

    @property
    def range_rad(self) -> np.ndarray:
        """Largest spread between any two replays at one time, per joint, shape (dof,)."""
        return np.ptp(self.q, axis=0).max(axis=0)


def as_sent(plan: Replayable, settings: ReplaySettings) -> Trajectory:
    """What goes to admission.

    Raises:
        RecordingError: Only what a stop left of the plan was recorded.
        TargetError: Speed or start time out of range.
    """
    _check_whole(plan)
    return slowed(from_time(plan.trajectory, settings.t_start), settings.speed)


def _check_whole(plan: Replayable) -> None:
    if plan.cut_s is not None:
        raise RecordingError(
            f"plan {plan.number} '{plan.label}' was broken off by a stop {plan.cut_s:.2f} s after its start, and this "
            "recording holds what was played, not what was planned: braking is no plan. Replay it from the run.mcap of "
            "the host that sent it"
        )


def replay_plan(
    link: ExecutorLink,
    arm: ArmModel,
    plan: Replayable,
    settings: ReplaySettings | None = None,
    obstacles: Sequence[Obstacle] = (),
    plans: Sequence[Replayable] = (),
    as_found: bool = False,
) -> Replayed:
    """Go to where it begins, send the plan, and compare with its first execution.

    Args:
        link: To the executor.
        arm: Kinematics for the way to the start.
        plan: Which.
        settings: How.
        obstacles: Besides the table, for the way to the start.
        plans: All of the source: where the arm stands at the start of an earlier one, it goes the recorded way.
        as_found: The world is as the recording found it: everything recorded before the plan is sent first, as far as
            it forms one unbroken row.

    Raises:
        NoMotionError: No free way to the start.
        RecordingError: Of this plan or of one on the way to it only what a stop left was recorded.
        CommandRefusedError: Admission refused it; the text says why.
        ArmStoppedError: A protection stopped it, or the operator at a step.
    """
    settings = settings or ReplaySettings()
    trajectory = as_sent(plan, settings)
    with link.leased():
        link.arm_drives()
        q_now = link.status().q_ref
        there = not as_found and joined(q_now, trajectory.q[0])
        way = [] if there else recorded_way(plans, plan, q_now, whole=as_found)
        for motion, label in [] if there else _before(plan, way, settings):
            _go_to(link, arm, motion.q[0], obstacles, label)
            link.wait_done(link.send_plan(motion, f"replay: {label}"))
        _go_to(link, arm, trajectory.q[0], obstacles, f"'{plan.label}'")
        verdict = link.send_plan(trajectory, f"replay of '{plan.label}'")
        if settings.step_s > 0:
            _step(link, verdict.seq, settings)
        link.wait_done(verdict)
    recording = link.recording(verdict.seq)
    compared = _against_first(plan, settings, trajectory, recording, verdict.seq)
    return Replayed(plan, verdict.seq, recording, compared, missing_of(plans, plan, way) if as_found else ())


def _before(
    plan: Replayable, way: Sequence[Replayable], settings: ReplaySettings
) -> list[tuple[Trajectory, str]]:
    """What is sent before the replay, with labels: the plans on the way, then the plan itself up to where it begins.

    Raises:
        RecordingError: Only what a stop left of one of them was recorded.
    """
    for earlier in way:
        _check_whole(earlier)
    motions = [(slowed(one.trajectory, settings.speed), f"'{one.label}' on the way") for one in way]
    if settings.t_start > 0.0:
        own = until_time(plan.trajectory, settings.t_start)
        if np.ptp(own.q, axis=0).max() > JOINED_RAD:
            slow = slowed(own, min(TRAVEL_SPEED, settings.speed))
            motions.append((slow, f"'{plan.label}' up to {settings.t_start:g} s"))
    return motions


def _step(link: ExecutorLink, seq: int, settings: ReplaySettings) -> None:
    """Pause on the path, ask, go on; the last pause is skipped when the plan ends before it."""
    due = settings.step_s
    while True:
        status = link.status()
        if status.plan_seq != seq or status.state not in (ExecutorState.RUN, ExecutorState.PAUSED):
            return
        if status.state == ExecutorState.RUN and status.plan_t >= due:
            link.pause()
            due = status.plan_t + settings.step_s
            if settings.next_step(status.plan_t):
                link.resume()
            else:
                link.stop()
                return
        time.sleep(0.005)


def _against_first(
    plan: Replayable, settings: ReplaySettings, sent: Trajectory, recording: bytes, seq: int
) -> Comparison:
    again = plan_track(recording, seq)
    if plan.first is None:
        played = _on(again, again.t)
        q_sent = sent.sample(played.t)[0]
        return Comparison(played.t, q_sent, q_sent, played.q)
    mapped = path_time(again.t, settings.t_start, settings.speed, plan.trajectory.duration_s)
    return compare(plan.trajectory, plan.first, _on(again, mapped))


@dataclass(frozen=True, eq=False)
class _Mapped:
    t: np.ndarray
    q: np.ndarray


def _on(track: JointTrack, t: np.ndarray) -> _Mapped:
    keep = np.concatenate([[True], np.diff(t) > 0])
    return _Mapped(t[keep], track.q[keep])


def compare(trajectory: Trajectory, first: JointTrack, again: JointTrack | _Mapped) -> Comparison:
    """Both tracks at the first one's times, as far as both go.

    Raises:
        RecordingError: They do not overlap.
    """
    inside = (first.t >= again.t[0]) & (first.t <= again.t[-1])
    if not inside.any():
        raise RecordingError("the two recordings have no plan time in common")
    t = first.t[inside]
    q_again = np.column_stack([np.interp(t, again.t, column) for column in again.q.T])
    return Comparison(t, trajectory.sample(t)[0], first.q[inside], q_again)


def repeatability(replays: Sequence[Replayed], names: tuple[str, ...]) -> Repeatability:
    """The spread of several replays of one plan.

    Raises:
        RecordingError: Fewer than two.
    """
    if len(replays) < 2:
        raise RecordingError(f"{len(replays)} replay says nothing about repeatability; use --loop 2 or more")
    end = min(r.comparison.t[-1] for r in replays)
    begin = max(r.comparison.t[0] for r in replays)
    t = np.arange(begin, end, 0.005)
    q = [
        np.column_stack([np.interp(t, r.comparison.t, column) for column in r.comparison.q_again.T])
        for r in replays
    ]
    return Repeatability(t, np.array(q), names)


def _go_to(
    link: ExecutorLink, arm: ArmModel, q_start: np.ndarray, obstacles: Sequence[Obstacle], label: str
) -> None:
    """A move to a motion's start that avoids table, obstacles and the arm itself; nothing when it stands there."""
    q_now = link.status().q_ref
    if np.abs(q_now - q_start).max() < AT_START_RAD:
        return
    checker = CollisionChecker(arm, [table_obstacle(), *obstacles])
    path = plan_joint_motion(
        checker, q_now, q_start, np.random.default_rng(0), what="way to the plan's start"
    )
    move = time_law(path, arm.arm, TimeLawSettings(speed=TRAVEL_SPEED))
    link.wait_done(link.send_plan(move, f"replay: to the start of {label}"))
