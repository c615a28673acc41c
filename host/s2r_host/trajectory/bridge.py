"""The fastest motion between two postures, jerk-limited, for bridges through free space."""

from __future__ import annotations

import numpy as np
import ruckig

from s2r_host.trajectory.torque import InverseDynamics, torque_stretch
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError, check_positions
from s2r_protocol.arms import ArmDescription

_MERGE_S = 1e-4  # switching times nearer than this become one knot


def point_to_point(
    q0: np.ndarray, q1: np.ndarray, arm: ArmDescription, speed: float = 1.0, share: float = 0.9
) -> Trajectory:
    """Move from q0 to q1 along a straight line in joint space, from rest to rest, within all limits.

    Ruckig's profile has constant jerk between switching times. Knots are put there, so each quintic is that very
    cubic and no limit is exceeded between knots.

    Args:
        q0, q1: Start and end [rad], (dof,).
        arm: Its limits and dynamics.
        speed: 1 is as fast as the limits allow; 0.5 takes twice the time.
        share: Share of the velocity, acceleration and jerk limits that is used; torques use 0.9. What is left is room
            for the executor's stop: with 0.95 a third of long motions would need more than 2 s to stop on their path.

    Raises:
        TrajectoryError: The postures are the same, not finite or outside the limits, or cannot be held.
    """
    q0, q1 = np.asarray(q0, dtype=float), np.asarray(q1, dtype=float)
    for name, q in (("q0", q0), ("q1", q1)):
        if q.shape != (arm.dof,) or not np.isfinite(q).all():
            raise TrajectoryError(f"{name} = {q} is not {arm.dof} finite joint positions of arm {arm.name!r}")
    if np.abs(q1 - q0).max() < 1e-6:
        raise TrajectoryError("the motion does not move: q0 and q1 are the same posture")
    times, share_done = _ruckig(q1 - q0, arm, share)
    x, dx, ddx = (column[:, None] for column in share_done.T)
    trajectory = Trajectory(times, q0 + x * (q1 - q0), dx * (q1 - q0), ddx * (q1 - q0))
    stretch = torque_stretch(trajectory, arm, InverseDynamics(arm), 0.9)
    trajectory = trajectory.stretched(stretch / speed)
    check_positions(trajectory, arm)
    return trajectory


def _ruckig(way: np.ndarray, arm: ArmDescription, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Switching times (n,) and there the share of the way done, its speed and acceleration, (n, 3).

    One coordinate along the line, limited by whichever joint is: asked for all joints at once, Ruckig leaves the
    line when it cannot synchronise their phases.
    """
    limits, size = arm.limits, np.maximum(np.abs(way), 1e-12)
    goal = ruckig.InputParameter(1)
    goal.target_position = [1.0]
    goal.max_velocity = [share * (limits.dq_max / size).min()]
    goal.max_acceleration = [share * (limits.ddq_max / size).min()]
    goal.max_jerk = [share * (limits.dddq_max / size).min()]
    profile = ruckig.Trajectory(1)
    verdict = ruckig.Ruckig(1).calculate(goal, profile)
    if verdict != ruckig.Result.Working:
        raise TrajectoryError(f"no profile over {np.round(way, 3)} rad: {verdict.name}")
    times = [0.0]
    for t in np.cumsum(profile.profiles[0][0].t):
        if t - times[-1] > _MERGE_S and t < profile.duration - _MERGE_S:
            times.append(float(t))
    times.append(profile.duration)
    states = np.array([np.ravel(profile.at_time(t)[:3]) for t in times])
    states[0], states[-1] = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]
    return np.array(times), states
