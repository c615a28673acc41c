"""Position, velocity, acceleration and jerk of every segment against the arm's limits, between knots too."""

from __future__ import annotations

import numpy as np

from s2r_executor.extrema import Exceedance, find_exceedance, hull
from s2r_executor.plan import CommandRefusedError
from s2r_executor.quintic import Spline, control_points
from s2r_protocol.arms import JointLimits
from s2r_protocol.faults import Refusal

RELATIVE_TOLERANCE = 1e-6
"""On velocity, acceleration and jerk: rounding of a planner that rides its limit. The core's gate has 2 %."""

POSITION_TOLERANCE_RAD = 1e-12
"""Rounding of the polynomial between knots; knots themselves are compared exactly."""


def check_bounds(spline: Spline, limits: JointLimits, joint_names: tuple[str, ...]) -> dict[str, float]:
    """Refuse the worst exceedance of the first quantity that has one.

    Returns:
        Largest share of each limit in use, from the control points: an upper bound, 1 is the limit.
    """
    position, velocity, acceleration, jerk = control_points(spline)
    _check_knots(spline, limits, joint_names)
    rows = (
        (position, limits.q_min, limits.q_max, "position", "rad", Refusal.POSITION),
        (velocity, -limits.dq_max, limits.dq_max, "velocity", "rad/s", Refusal.VELOCITY),
        (acceleration, -limits.ddq_max, limits.ddq_max, "acceleration", "rad/s²", Refusal.ACCELERATION),
        (jerk, -limits.dddq_max, limits.dddq_max, "jerk", "rad/s³", Refusal.JERK),
    )
    margins = {}
    for control, lower, upper, quantity, unit, code in rows:
        is_position = code is Refusal.POSITION
        tolerance = np.full(len(upper), POSITION_TOLERANCE_RAD) if is_position else RELATIVE_TOLERANCE * upper
        largest, smallest = hull(control)
        worst = find_exceedance(control, lower, upper, tolerance, (largest, smallest))
        if worst is not None:
            raise _refusal(worst, spline, joint_names, quantity, unit, code)
        middle, half = (upper + lower) / 2, (upper - lower) / 2
        margins[quantity] = float(np.max(np.maximum(largest - middle, middle - smallest) / half))
    return margins


def _check_knots(spline: Spline, limits: JointLimits, joint_names: tuple[str, ...]) -> None:
    """Positions at knots need no arithmetic, so one unit in the last place outside is outside."""
    outside = ~((spline.q >= limits.q_min) & (spline.q <= limits.q_max))
    knots, joints = np.nonzero(outside)
    if not len(knots):
        return
    excess = np.maximum(spline.q - limits.q_max, limits.q_min - spline.q)[knots, joints]
    k, j = int(knots[np.argmax(excess)]), int(joints[np.argmax(excess)])
    value = float(spline.q[k, j])
    limit = float(limits.q_max[j] if value > limits.q_max[j] else limits.q_min[j])
    raise CommandRefusedError(
        Refusal.POSITION,
        f"joint '{joint_names[j]}' (index {j}): position {value!r} rad at {spline.t[k]:.4f} s is outside "
        f"[{limits.q_min[j]:g}, {limits.q_max[j]:g}] rad; plan inside them",
        joint=joint_names[j],
        t=float(spline.t[k]),
        quantity="position",
        value=value,
        limit=limit,
    )


def _refusal(
    worst: Exceedance, spline: Spline, joint_names: tuple[str, ...], quantity: str, unit: str, code: Refusal
) -> CommandRefusedError:
    start, end = spline.t[worst.segment], spline.t[worst.segment + 1]
    t = float(start + worst.fraction * (end - start))
    what_to_do = (
        "plan farther inside, or set knots closer"
        if code is Refusal.POSITION
        else "give the motion more time there"
    )
    where = "at" if worst.fraction in (0.0, 1.0) else "between knots at"
    return CommandRefusedError(
        code,
        f"joint '{joint_names[worst.joint]}' (index {worst.joint}): {quantity} {worst.value:.9g} {unit} {where} "
        f"{t:.4f} s exceeds the limit {worst.limit:g} {unit}; {what_to_do}",
        joint=joint_names[worst.joint],
        t=t,
        quantity=quantity,
        value=worst.value,
        limit=worst.limit,
    )
