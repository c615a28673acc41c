"""From a state in motion to rest at a posture, inside the limits: what a running plan is continued with."""

from __future__ import annotations

import numpy as np
import ruckig

from s2r_host.trajectory.time_law import limit_stretch
from s2r_host.trajectory.torque import LOOK_STEP_S, InverseDynamics
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError, check_positions
from s2r_protocol.arms import ArmDescription

# Between two knots Ruckig's jerk may switch, a quintic's cannot: it swings a little around the profile.
_HEADROOM, _JERK_HEADROOM = 0.9, 0.5


def to_rest(
    start: tuple[np.ndarray, np.ndarray, np.ndarray],
    goal: np.ndarray,
    arm: ArmDescription,
    duration_s: float,
    dynamics: InverseDynamics | None = None,
    torque_share: float = 0.9,
) -> Trajectory:
    """A jerk-limited motion that begins with exactly the given state and ends at rest.

    Args:
        start: Position [rad], velocity [rad/s], acceleration [rad/s²], (dof,) each.
        goal: Where it ends [rad], (dof,).
        arm: Its limits.
        duration_s: The least time it takes.
        dynamics: Of the arm; None skips the check of torques.
        torque_share: Share of the torque limits that may be used.

    Raises:
        TrajectoryError: No such motion exists inside the limits.
    """
    limits, dof = arm.limits, arm.dof
    wanted = ruckig.InputParameter(dof)
    wanted.current_position, wanted.current_velocity, wanted.current_acceleration = (
        values.tolist() for values in start
    )
    wanted.target_position = goal.tolist()
    wanted.max_velocity = (_HEADROOM * limits.dq_max).tolist()
    wanted.max_acceleration = (_HEADROOM * limits.ddq_max).tolist()
    wanted.max_jerk = (_JERK_HEADROOM * limits.dddq_max).tolist()
    wanted.minimum_duration = duration_s
    profile = ruckig.Trajectory(dof)
    try:
        verdict = ruckig.Ruckig(dof).calculate(wanted, profile)
    except ruckig.RuckigError as error:
        raise TrajectoryError(f"no motion from this state to rest: {error}") from error
    if verdict not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise TrajectoryError(f"no motion from this state to rest: {verdict.name}")
    t = np.linspace(0.0, profile.duration, max(2, int(np.ceil(profile.duration / LOOK_STEP_S))) + 1)
    states = np.array([profile.at_time(x) for x in t])
    q, dq, ddq = states[:, 0], states[:, 1], states[:, 2]
    q[0], dq[0], ddq[0] = start
    q[-1], dq[-1], ddq[-1] = goal, 0.0, 0.0
    trajectory = Trajectory(t, q, dq, ddq)
    check_positions(trajectory, arm)
    excess = limit_stretch(trajectory, arm, 1.0)
    if excess > 1.0:
        raise TrajectoryError(
            f"the motion to rest exceeds a limit of arm {arm.name!r} by a factor {excess:.3f}"
        )
    if dynamics is not None:
        tau = np.abs(dynamics.along(q, dq, ddq)) / limits.tau_max
        if tau.max() > torque_share:
            joint = arm.joint_names[int(np.unravel_index(tau.argmax(), tau.shape)[1])]
            raise TrajectoryError(f"joint {joint!r}: the motion to rest takes {tau.max():.0%} of its torque")
    return trajectory
