"""A short motion from where the running plan will be to where the new one wants to go on.

For a replacement plan that does not begin exactly on the running one. Ruckig (Berscheid and Kröger, "Jerk-limited
real-time trajectory generation with arbitrary target states", RSS 2021) joins the two states inside the limits; what
comes out is admitted like any other plan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import ruckig

from s2r_executor.config import AdmissionConfig
from s2r_executor.plan import CommandRefusedError, PlanRequest
from s2r_executor.quintic import sample, spline_through
from s2r_protocol.arms import JointLimits
from s2r_protocol.faults import Refusal

_JOIN_AFTER_S = (0.2, 0.4, 0.8, 1.6)
_KNOT_S = 0.01
_HEADROOM = (
    0.9  # of velocity and acceleration: the quintic through Ruckig's states swings a little around them
)
_JERK_HEADROOM = 0.5  # between two knots Ruckig's jerk may switch, a quintic's cannot
_LONGEST = 4.0  # times the plan's own time to the joint


@dataclass(frozen=True, eq=False)
class PathState:
    """Where the running plan will be, per joint, each of shape (dof,): rad, rad/s, rad/s²."""

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


def bridge(plan: PlanRequest, start: PathState, limits: JointLimits, config: AdmissionConfig) -> PlanRequest:
    """The plan with a motion from ``start`` in front of it, joining it after 0.2 to 1.6 s of its own time.

    Raises:
        CommandRefusedError: SPLICE; the two are too far apart, or no bridge holds the limits.
    """
    _check_near(plan, start, config)
    own = spline_through(plan.t, plan.q, plan.dq, plan.ddq)
    for join_s in (*_JOIN_AFTER_S, float(plan.t[-1])):
        if join_s > plan.t[-1]:
            continue
        target = sample(own, np.array([join_s]))
        found = _motion(start, PathState(target.q[0], target.dq[0], target.ddq[0]), join_s, limits)
        if found is None:
            continue
        t, q, dq, ddq = found
        rest = plan.t > join_s + config.min_segment_s
        return replace(
            plan,
            t=np.concatenate([t, plan.t[rest] - join_s + t[-1]]),
            q=np.concatenate([q, plan.q[rest]]),
            dq=np.concatenate([dq, plan.dq[rest]]),
            ddq=np.concatenate([ddq, plan.ddq[rest]]),
        )
    raise CommandRefusedError(
        Refusal.SPLICE,
        f"no motion inside the limits joins the running plan at {plan.splice_t:.3f} s with the new one; "
        "splice later or plan from the running plan's state",
        t=plan.splice_t,
        quantity="bridge",
    )


def _check_near(plan: PlanRequest, start: PathState, config: AdmissionConfig) -> None:
    for name, unit, own, there, limit in (
        ("position", "rad", plan.q[0], start.q, config.bridge_max_rad),
        ("velocity", "rad/s", plan.dq[0], start.dq, config.bridge_max_rad_s),
    ):
        off = np.abs(own - there)
        j = int(np.argmax(off))
        if not off[j] <= limit:
            raise CommandRefusedError(
                Refusal.SPLICE,
                f"joint '{plan.joint_names[j]}' (index {j}): {name} {own[j]:.6g} {unit} where the running plan has "
                f"{there[j]:.6g} {unit} at {plan.splice_t:.3f} s; they may differ by {limit:g} {unit}",
                joint=plan.joint_names[j],
                t=plan.splice_t,
                quantity=name,
                value=float(off[j]),
                limit=limit,
            )


def _motion(
    start: PathState, target: PathState, duration_s: float, limits: JointLimits
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Knots from ``start`` to ``target`` inside the limits, or None."""
    dof = len(start.q)
    wanted = ruckig.InputParameter(dof)
    wanted.current_position, wanted.target_position = start.q.tolist(), target.q.tolist()
    wanted.current_velocity, wanted.target_velocity = start.dq.tolist(), target.dq.tolist()
    wanted.current_acceleration, wanted.target_acceleration = start.ddq.tolist(), target.ddq.tolist()
    wanted.max_velocity = (_HEADROOM * limits.dq_max).tolist()
    wanted.max_acceleration = (_HEADROOM * limits.ddq_max).tolist()
    wanted.max_jerk = (_JERK_HEADROOM * limits.dddq_max).tolist()
    wanted.minimum_duration = duration_s
    motion = ruckig.Trajectory(dof)
    try:
        verdict = ruckig.Ruckig(dof).calculate(wanted, motion)
    except ruckig.RuckigError:  # one of the two states is outside the limits by itself
        return None
    if verdict not in (ruckig.Result.Working, ruckig.Result.Finished):
        return None
    if motion.duration > _LONGEST * duration_s:
        return None
    t = np.linspace(0.0, motion.duration, max(2, int(np.ceil(motion.duration / _KNOT_S))) + 1)
    states = np.array([motion.at_time(x) for x in t])
    q, dq, ddq = states[:, 0], states[:, 1], states[:, 2]
    q[0], dq[0], ddq[0] = start.q, start.dq, start.ddq
    q[-1], dq[-1], ddq[-1] = target.q, target.dq, target.ddq
    return t, q, dq, ddq
