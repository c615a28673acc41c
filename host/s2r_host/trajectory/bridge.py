"""The fastest motion between two postures, jerk-limited, for bridges through free space."""

from __future__ import annotations

import numpy as np
import ruckig

from s2r_host.trajectory.torque import InverseDynamics, torque_stretch
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError, check_positions
from s2r_protocol.arms import ArmDescription

_MERGE_S = 1e-4  # switching times nearer than this become one knot


def point_to_point(
    q0: np.ndarray, q1: np.ndarray, arm: ArmDescription, speed: float = 1.0, share: float = 0.95
) -> Trajectory:
    """Move from q0 to q1 along a straight line in joint space, from rest to rest, within all limits.

    Ruckig's profiles have constant jerk between switching times. Knots are put at the switching times of all
    joints, so each quintic is that very cubic and no limit is exceeded between knots.

    Args:
        q0, q1: Start and end [rad], (dof,).
        arm: Its limits and dynamics.
        speed: 1 is as fast as the limits allow; 0.5 takes twice the time.
        share: Share of the velocity, acceleration and jerk limits that is used; torques use 0.9.

    Raises:
        TrajectoryError: The postures are the same, not finite or outside the limits, or cannot be held.
    """
    q0, q1 = np.asarray(q0, dtype=float), np.asarray(q1, dtype=float)
    for name, q in (("q0", q0), ("q1", q1)):
        if q.shape != (arm.dof,) or not np.isfinite(q).all():
            raise TrajectoryError(f"{name} = {q} is not {arm.dof} finite joint positions of arm {arm.name!r}")
    if np.abs(q1 - q0).max() < 1e-6:
        raise TrajectoryError("the motion does not move: q0 and q1 are the same posture")
    times, profile = _ruckig(q0, q1, arm, share)
    states = [profile.at_time(float(t)) for t in times]
    q, dq, ddq = (np.array([state[k] for state in states]) for k in range(3))
    q[0], q[-1] = q0, q1
    dq[[0, -1]], ddq[[0, -1]] = 0.0, 0.0
    trajectory = Trajectory(times, q, dq, ddq)
    stretch = torque_stretch(trajectory, arm, InverseDynamics(arm), 0.9)
    trajectory = trajectory.stretched(stretch / speed)
    check_positions(trajectory, arm)
    return trajectory


def _ruckig(
    q0: np.ndarray, q1: np.ndarray, arm: ArmDescription, share: float
) -> tuple[np.ndarray, ruckig.Trajectory]:
    """The profile and the switching times of its joints."""
    goal = ruckig.InputParameter(arm.dof)
    goal.current_position, goal.target_position = q0.tolist(), q1.tolist()
    goal.max_velocity = (share * arm.limits.dq_max).tolist()
    goal.max_acceleration = (share * arm.limits.ddq_max).tolist()
    goal.max_jerk = (share * arm.limits.dddq_max).tolist()
    goal.synchronization = ruckig.Synchronization.Phase
    profile = ruckig.Trajectory(arm.dof)
    verdict = ruckig.Ruckig(arm.dof).calculate(goal, profile)
    if verdict != ruckig.Result.Working:
        raise TrajectoryError(f"no profile from {np.round(q0, 3)} to {np.round(q1, 3)} rad: {verdict.name}")
    switches = {0.0, profile.duration}
    for joint in profile.profiles[0]:
        switches.update(np.cumsum(joint.t).tolist())
    times = [0.0]
    for t in sorted(switches):
        if t - times[-1] > _MERGE_S and t < profile.duration - _MERGE_S:
            times.append(t)
    return np.array([*times, profile.duration]), profile
