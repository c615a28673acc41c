"""For every segment the shortest legal on-path stop that may begin anywhere in it.

A stop slows path time: rate r(τ) = 1 − S(τ/T) with S(x) = 6x⁵ − 15x⁴ + 10x³. Along the path q(s):
velocity q' r, acceleration q'' r² + q' ṙ, jerk q''' r³ + 3 q'' r ṙ + q' r̈, torque g(q) + b(q, q', q'') r² + (M q') ṙ.
A stop that begins at s covers T/2 of path time; beyond the plan's end the arm is at rest anyway.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from s2r_executor import _native
from s2r_executor.plan import CommandRefusedError
from s2r_executor.quintic import Spline, sample
from s2r_protocol.arms import JointLimits
from s2r_protocol.faults import Refusal

Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(q, dq, ddq) of shape (m, dof) -> torque (m, dof)."""

ALLOWANCE = 1.01
"""On v, a, j while stopping: a plan that brakes at its limit has no slack for any stop; the core's gate allows 1.02."""

_SHORTEST_S = 0.02
_RATIO = 1.2
_CELL_S = 0.004
_LOAD_STEP_S = 0.02  # torque varies with the pose


@dataclass(frozen=True, eq=False)
class Load:
    """Torque terms of the plan on a uniform grid, each (m, dof): g, b (what q'' and q'² cost) and M q'."""

    step_s: float
    gravity: np.ndarray
    path: np.ndarray
    inertia: np.ndarray


def load_along(spline: Spline, torque: Torque) -> Load:
    """What the plan's torque is made of."""
    count = max(3, int(np.ceil(spline.duration_s / _LOAD_STEP_S)) + 1)
    s = sample(spline, np.linspace(0.0, spline.t[-1], count))
    zero = np.zeros_like(s.q)
    gravity = torque(s.q, zero, zero)
    path, inertia = torque(s.q, s.dq, s.ddq) - gravity, torque(s.q, zero, s.dq) - gravity
    return Load(float(s.t[1] - s.t[0]), gravity, path, inertia)


def stop_durations(
    spline: Spline,
    load: Load,
    limits: JointLimits,
    joint_names: tuple[str, ...],
    tau_limit: np.ndarray,
    longest_s: float,
) -> np.ndarray:
    """Shortest legal duration of a stop, and of a resume after it, in each segment [s], shape (segments,).

    Velocity needs no check: both only lower it.

    Args:
        spline: The plan, itself within its limits.
        load: :func:`load_along` it.
        limits: Acceleration and jerk limits.
        joint_names: For the text of a refusal.
        tau_limit: [N·m], shape (dof,), margin already taken off.
        longest_s: Longest stop to accept.

    Raises:
        CommandRefusedError: NO_STOP_PATH, naming segment time, joint and quantity.
    """
    bounds = (ALLOWANCE * limits.ddq_max, ALLOWANCE * limits.dddq_max, tau_limit)
    durations, segment, largest = _native.shortest_blends(
        spline.t,
        spline.coefficients,
        (load.gravity, load.path, load.inertia),
        load.step_s,
        _CELL_S,
        _candidates(longest_s).tolist(),
        *bounds,
    )
    if segment < 0:
        return np.array(durations)
    raise _no_stop(float(spline.t[segment]), largest, bounds, joint_names, longest_s)


def _candidates(longest_s: float) -> np.ndarray:
    count = int(np.ceil(np.log(longest_s / _SHORTEST_S) / np.log(_RATIO))) + 1
    return np.minimum(_SHORTEST_S * _RATIO ** np.arange(count), longest_s)


_Bounds = tuple[np.ndarray, np.ndarray, np.ndarray]


def _no_stop(
    at_s: float, largest: _Bounds, bounds: _Bounds, joint_names: tuple[str, ...], longest_s: float
) -> CommandRefusedError:
    """The refusal for a segment: what the longest stop would need, whichever quantity is farthest outside."""
    rows = zip(("acceleration", "jerk", "torque"), ("rad/s²", "rad/s³", "N·m"), largest, bounds, strict=True)
    name, unit, values, limit = max(rows, key=lambda row: float((row[2] / row[3]).max()))
    joint = int(np.argmax(values / limit))
    return CommandRefusedError(
        Refusal.NO_STOP_PATH,
        f"joint '{joint_names[joint]}' (index {joint}): a stop begun at {at_s:.3f} s would need {name} "
        f"{values[joint]:.4g} {unit} even over {longest_s:g} s, allowed are {limit[joint]:.4g} {unit}; "
        "plan with more headroom",
        joint=joint_names[joint],
        t=at_s,
        quantity=name,
        value=float(values[joint]),
        limit=float(limit[joint]),
    )
