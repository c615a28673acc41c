"""For every segment the shortest legal on-path stop that may begin anywhere in it.

A stop slows path time: rate r(τ) = 1 − S(τ/T) with S(x) = 6x⁵ − 15x⁴ + 10x³. Along the path q(s):
velocity q' r, acceleration q'' r² + q' ṙ, jerk q''' r³ + 3 q'' r ṙ + q' r̈, torque g(q) + b(q, q', q'') r² + (M q') ṙ.
A stop that begins at s covers T/2 of path time; beyond the plan's end the arm is at rest anyway.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

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
_GRID_S = 0.004
_GRID_MAX = 20_000
_POINTS = 24
_QUANTITIES = ("velocity", "acceleration", "jerk", "torque")
_UNITS = ("rad/s", "rad/s²", "rad/s³", "N·m")


def blend(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """S and its first two derivatives and its integral from 0, for x in [0, 1]."""
    s = x**3 * (10 + x * (-15 + 6 * x))
    ds = 30 * x**2 * (1 - x) ** 2
    dds = 60 * x * (1 - x) * (1 - 2 * x)
    integral = x**4 * (2.5 + x * (-3 + x))
    return s, ds, dds, integral


@dataclass(frozen=True, eq=False)
class _Path:
    """The plan on a uniform grid of path time; each array of shape (m, dof) except ``t``."""

    t: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    dddq: np.ndarray
    tau_gravity: np.ndarray
    tau_path: np.ndarray  # what q'' and q'² cost at rate 1
    tau_inertia: np.ndarray  # M q'


def stop_durations(
    spline: Spline,
    limits: JointLimits,
    torque: Torque,
    joint_names: tuple[str, ...],
    tau_limit: np.ndarray,
    longest_s: float,
) -> np.ndarray:
    """Shortest legal stop duration of each segment [s], shape (segments,).

    Args:
        spline: The plan.
        limits: Velocity, acceleration and jerk limits.
        torque: Inverse dynamics.
        joint_names: For the text of a refusal.
        tau_limit: [N·m], shape (dof,), margin already taken off.
        longest_s: Longest stop to accept.

    Raises:
        CommandRefusedError: NO_STOP_PATH, naming segment time, joint and quantity.
    """
    path = _on_grid(spline, torque)
    step = path.t[1] - path.t[0]
    first = np.clip(np.floor(spline.t[:-1] / step).astype(int), 0, len(path.t) - 1)
    last = np.clip(np.ceil(spline.t[1:] / step).astype(int), 0, len(path.t) - 1)
    starts_of = np.arange(len(path.t))
    duration = np.full(len(first), np.nan)
    limit = np.stack([limits.dq_max, limits.ddq_max, limits.dddq_max]) * ALLOWANCE
    limit = np.concatenate([limit, tau_limit[None]])
    start_legal = np.zeros(len(path.t), dtype=bool)
    for T in _candidates(longest_s):
        open_segments = np.isnan(duration)
        wanted = _marked(first[open_segments], last[open_segments], len(path.t))
        starts = starts_of[wanted]
        start_legal[:] = False
        start_legal[starts] = _legal(path, starts, T, step, limit)
        counted = np.concatenate([[0], np.cumsum(start_legal)])
        whole = counted[last + 1] - counted[first] == last + 1 - first
        duration[open_segments & whole] = T
        if not np.isnan(duration).any():
            return duration
    raise _no_stop(path, spline, first, last, duration, step, limit, joint_names, longest_s)


def _candidates(longest_s: float) -> np.ndarray:
    count = int(np.ceil(np.log(longest_s / _SHORTEST_S) / np.log(_RATIO))) + 1
    return np.minimum(_SHORTEST_S * _RATIO ** np.arange(count), longest_s)


def _marked(first: np.ndarray, last: np.ndarray, count: int) -> np.ndarray:
    """True where any of the closed index ranges lies, shape (count,)."""
    edges = np.zeros(count + 1, dtype=int)
    np.add.at(edges, first, 1)
    np.add.at(edges, last + 1, -1)
    return np.cumsum(edges)[:-1] > 0


def _on_grid(spline: Spline, torque: Torque) -> _Path:
    count = int(np.clip(np.ceil(spline.duration_s / _GRID_S) + 1, 9, _GRID_MAX))
    s = sample(spline, np.linspace(0.0, spline.t[-1], count))
    zero = np.zeros_like(s.q)
    gravity = torque(s.q, zero, zero)
    return _Path(
        t=s.t,
        dq=s.dq,
        ddq=s.ddq,
        dddq=s.dddq,
        tau_gravity=gravity,
        tau_path=torque(s.q, s.dq, s.ddq) - gravity,
        tau_inertia=torque(s.q, zero, s.dq) - gravity,
    )


def _ramp(T: float, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Grid offsets inside a stop of duration T, with r, ṙ, r̈ there; at least a few, at most ``_POINTS``."""
    x = np.linspace(0.0, 1.0, 257)
    s, ds, dds, integral = blend(x)
    covered = T * (x - integral)  # path time used up
    stride = max(1, int(T / 2 / step / _POINTS))
    offsets = np.arange(0, int(T / 2 / step) + 1, stride)
    at = np.interp(offsets * step, covered, x)
    if len(offsets) < 8:  # shorter than the grid resolves: take the path as constant at the start
        at = np.linspace(0.0, 1.0, 12)
        offsets = np.rint(T * (at - blend(at)[3]) / step).astype(int)
    s, ds, dds, _ = blend(at)
    return offsets, 1 - s, -ds / T, -dds / T**2


def _values(path: _Path, starts: np.ndarray, T: float, step: float) -> np.ndarray:
    """Velocity, acceleration, jerk and torque along stops that begin at ``starts``: (4, starts, points, dof)."""
    offsets, r, dr, ddr = _ramp(T, step)
    index = starts[:, None] + offsets[None, :]
    inside = (index < len(path.t))[:, :, None]  # beyond the end the arm is at rest
    index = np.minimum(index, len(path.t) - 1)
    r, dr, ddr = r[None, :, None], dr[None, :, None], ddr[None, :, None]
    dq, ddq, dddq = path.dq[index], path.ddq[index], path.dddq[index]
    return np.stack(
        [
            inside * dq * r,
            inside * (ddq * r**2 + dq * dr),
            inside * (dddq * r**3 + 3 * ddq * r * dr + dq * ddr),
            path.tau_gravity[index] + inside * (path.tau_path[index] * r**2 + path.tau_inertia[index] * dr),
        ]
    )


def _legal(path: _Path, starts: np.ndarray, T: float, step: float, limit: np.ndarray) -> np.ndarray:
    """Which of the starts have a legal stop of duration T, shape (starts,)."""
    worst = np.abs(_values(path, starts, T, step)).max(axis=2)
    return (worst <= limit[:, None, :]).all(axis=(0, 2))


def _no_stop(
    path: _Path,
    spline: Spline,
    first: np.ndarray,
    last: np.ndarray,
    duration: np.ndarray,
    step: float,
    limit: np.ndarray,
    joint_names: tuple[str, ...],
    longest_s: float,
) -> CommandRefusedError:
    segment = int(np.nonzero(np.isnan(duration))[0][0])
    starts = np.arange(first[segment], last[segment] + 1)
    worst = np.abs(_values(path, starts, longest_s, step)).max(axis=(1, 2))
    quantity, joint = np.unravel_index(int(np.argmax(worst / limit)), limit.shape)
    name, unit = _QUANTITIES[quantity], _UNITS[quantity]
    value, bound = float(worst[quantity, joint]), float(limit[quantity, joint])
    return CommandRefusedError(
        Refusal.NO_STOP_PATH,
        f"joint '{joint_names[joint]}' (index {joint}): a stop begun at {spline.t[segment]:.3f} s would need {name} "
        f"{value:.4g} {unit} even over {longest_s:g} s, allowed are {bound:.4g} {unit}; plan with more headroom",
        joint=joint_names[joint],
        t=float(spline.t[segment]),
        quantity=name,
        value=value,
        limit=bound,
    )
