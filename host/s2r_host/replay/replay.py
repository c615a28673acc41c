"""Send a recorded plan again: to its start by a checked move, through the same admission, then compare."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.link import ExecutorLink
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.collision import CollisionChecker
from s2r_host.motion.joint_motion import plan_joint_motion
from s2r_host.motion.obstacles import Obstacle, table_obstacle
from s2r_host.recording import JointTrack, RecordedPlan, plan_track, read_plans
from s2r_host.trajectory import TimeLawSettings, Trajectory, time_law

logger = logging.getLogger(__name__)

AT_START_RAD = 1e-4
TRAVEL_SPEED = 0.5
DEFAULT_LABEL = "manipulation"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two executions of one plan, sampled at the same plan times.

    Attributes:
        t: Plan times both recordings cover [s], shape (n,).
        q_planned, q_first, q_again: [rad], shape (n, dof).
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
    """A plan that was sent again."""

    plan: RecordedPlan
    seq: int
    recording: bytes
    comparison: Comparison


def pick_plan(run: Path, number: int | None) -> RecordedPlan:
    """A plan of a run folder: by its number, by default the first planned manipulation, else the last plan.

    Raises:
        RecordingError: The run has no such plan.
    """
    plans = read_plans(run / "run.mcap")
    if number is None:
        named = [plan for plan in plans if plan.label.startswith(DEFAULT_LABEL)]
        return named[0] if named else plans[-1]
    for plan in plans:
        if plan.number == number:
            return plan
    known = ", ".join(f"{plan.number} ({plan.label})" for plan in plans)
    raise RecordingError(f"{run} has no plan {number}; it has {known}")


def replay_plan(
    link: ExecutorLink, arm: ArmModel, run: Path, plan: RecordedPlan, obstacles: Sequence[Obstacle] = ()
) -> Replayed:
    """Go to the plan's start, send it, and compare both recordings.

    Args:
        link: To the executor.
        arm: Kinematics for the way to the start.
        run: Folder with the first recording.
        plan: Which.
        obstacles: Besides the table, for the way to the start.

    Raises:
        NoMotionError: No free way to the start.
        CommandRefusedError: Admission refused it; the text says why.
        ArmStoppedError: A protection stopped it.
    """
    bridge = _bridge(link, arm, plan, obstacles)
    trajectory = Trajectory(plan.t, plan.q, plan.dq, plan.ddq)
    with link.leased():
        link.arm_drives()
        if bridge is not None:
            link.wait_done(link.send_plan(bridge, f"replay: to the start of '{plan.label}'"))
        verdict = link.send_plan(trajectory, f"replay of '{plan.label}'")
        link.wait_done(verdict)
    recording = link.recording(verdict.seq)
    first = plan_track(run / "run.mcap", plan.seq)
    return Replayed(
        plan, verdict.seq, recording, compare(trajectory, first, plan_track(recording, verdict.seq))
    )


def compare(trajectory: Trajectory, first: JointTrack, again: JointTrack) -> Comparison:
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


def _bridge(
    link: ExecutorLink, arm: ArmModel, plan: RecordedPlan, obstacles: Sequence[Obstacle]
) -> Trajectory | None:
    q_now = link.status().q_ref
    if np.abs(q_now - plan.q[0]).max() < AT_START_RAD:
        return None
    checker = CollisionChecker(arm, [table_obstacle(), *obstacles])
    path = plan_joint_motion(
        checker, q_now, plan.q[0], np.random.default_rng(0), what="way to the plan's start"
    )
    return time_law(path, arm.arm, TimeLawSettings(speed=TRAVEL_SPEED))
