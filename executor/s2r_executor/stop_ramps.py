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
_GRID_S = 0.004
_GRID_MAX = 20_000
_TORQUE_STRIDE = 5  # torque varies with the pose and needs a coarser grid than jerk
_POINTS = 16


def blend(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """S and its first two derivatives and its integral from 0, for x in [0, 1]."""
    s = x**3 * (10 + x * (-15 + 6 * x))
    ds = 30 * x**2 * (1 - x) ** 2
    dds = 60 * x * (1 - x) * (1 - 2 * x)
    integral = x**4 * (2.5 + x * (-3 + x))
    return s, ds, dds, integral


@dataclass(frozen=True, eq=False)
class Path:
    """The plan on a uniform grid of path time; each term has shape (m, dof).

    Attributes:
        step_s: Grid spacing.
        dq, ddq, dddq: q', q'', q'''.
    """

    step_s: float
    dq: np.ndarray
    ddq: np.ndarray
    dddq: np.ndarray


@dataclass(frozen=True, eq=False)
class Load:
    """Torque terms of the plan on a coarser grid, each of shape (m, dof): g, b (what q'' and q'² cost) and M q'."""

    step_s: float
    gravity: np.ndarray
    path: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class _Worst:
    """Largest absolute values over a stop for each start, shape (starts, dof)."""

    acceleration: np.ndarray
    jerk: np.ndarray


Grids = tuple[Path, Load]


def stop_durations(
    spline: Spline,
    limits: JointLimits,
    torque: Torque,
    joint_names: tuple[str, ...],
    tau_limit: np.ndarray,
    longest_s: float,
    grids: Grids | None = None,
) -> np.ndarray:
    """Shortest legal duration of a stop, and of a resume after it, in each segment [s], shape (segments,).

    Velocity needs no check: both only lower it.

    Args:
        spline: The plan, itself within its limits.
        limits: Acceleration and jerk limits.
        torque: Inverse dynamics.
        joint_names: For the text of a refusal.
        tau_limit: [N·m], shape (dof,), margin already taken off.
        longest_s: Longest stop to accept.
        grids: The plan as :func:`on_grids` gives it, if known already.

    Raises:
        CommandRefusedError: NO_STOP_PATH, naming segment time, joint and quantity.
    """
    path, load = grids or on_grids(spline, torque)
    first = np.floor(spline.t[:-1] / path.step_s + 1e-9).astype(int)
    last = np.minimum(np.ceil(spline.t[1:] / path.step_s - 1e-9).astype(int), len(path.dq) - 1)
    duration = np.array(
        _native.shortest_blends(
            (path.dq, path.ddq, path.dddq),
            (load.gravity, load.path, load.inertia),
            path.step_s,
            _TORQUE_STRIDE,
            _candidates(longest_s).tolist(),
            ALLOWANCE * limits.ddq_max,
            ALLOWANCE * limits.dddq_max,
            tau_limit,
            first.tolist(),
            last.tolist(),
            _worth_trying(path, limits, first, last).tolist(),
        )
    )
    if not np.isnan(duration).any():
        return duration
    segment = int(np.nonzero(np.isnan(duration))[0][0])
    at_s, span = float(spline.t[segment]), (int(first[segment]), int(last[segment]) + 1)
    raise _no_stop(path, load, span, at_s, longest_s, limits, tau_limit, joint_names)


def _candidates(longest_s: float) -> np.ndarray:
    count = int(np.ceil(np.log(longest_s / _SHORTEST_S) / np.log(_RATIO))) + 1
    return np.minimum(_SHORTEST_S * _RATIO ** np.arange(count), longest_s)


def _worth_trying(path: Path, limits: JointLimits, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Per segment a duration below which a stop is not tried [s].

    At constant speed v the blend needs T >= 1.875 v / a and T >= 2.4 sqrt(v / j); a plan that slows down by itself may
    need half of that. Trying too few durations can make a stop longer than necessary, never illegal.
    """
    speed = np.abs(path.dq)
    hint = np.maximum(1.0 * speed / limits.ddq_max, 1.3 * np.sqrt(speed / limits.dddq_max)).max(axis=1)
    running = np.append(hint, 0.0)
    return np.maximum.reduceat(running, np.stack([first, last + 1], axis=1).ravel())[::2]


def on_grids(spline: Spline, torque: Torque) -> Grids:
    """The plan on uniform grids of path time: motion, and what its torque is made of."""
    count = int(np.clip(np.ceil(spline.duration_s / _GRID_S) + 1, 2 * _TORQUE_STRIDE + 1, _GRID_MAX))
    s = sample(spline, np.linspace(0.0, spline.t[-1], count))
    step_s = float(s.t[1] - s.t[0])
    q, dq, ddq = (a[::_TORQUE_STRIDE] for a in (s.q, s.dq, s.ddq))
    zero = np.zeros_like(q)
    gravity = torque(q, zero, zero)
    load = Load(step_s * _TORQUE_STRIDE, gravity, torque(q, dq, ddq) - gravity, torque(q, zero, dq) - gravity)
    return Path(step_s, s.dq, s.ddq, s.dddq), load


def _ramp(T: float, step_s: float) -> list[tuple[int, float, float, float]]:
    """Points of a stop of duration T: grid offset from its start, and r, ṙ, r̈ there."""
    x = np.linspace(0.0, 1.0, 257)
    covered = T * (x - blend(x)[3])  # path time used up
    stride = max(1, int(np.ceil(T / 2 / step_s / _POINTS)))
    offsets = np.arange(0, int(T / 2 / step_s) + 1, stride)
    at = np.interp(offsets * step_s, covered, x)
    if (
        len(offsets) < 8
    ):  # shorter than the grid resolves: sample the blend itself and take the nearest grid points
        at = np.linspace(0.0, 1.0, 12)
        offsets = np.rint(T * (at - blend(at)[3]) / step_s).astype(int)
    s, ds, dds, _ = blend(at)
    return list(zip(offsets.tolist(), 1 - s, -ds / T, -dds / T**2, strict=True))


def _motion(path: Path, start: int, end: int, T: float) -> _Worst:
    """Acceleration and jerk over stops that begin at grid points start .. end - 1."""
    acceleration = np.zeros((end - start, path.dq.shape[1]))
    jerk = np.zeros_like(acceleration)
    for offset, r, dr, ddr in _ramp(T, path.step_s):
        span = slice(start + offset, min(end + offset, len(path.dq)))  # beyond the end the arm is at rest
        n = span.stop - span.start
        if n <= 0:
            break
        dq, ddq, dddq = path.dq[span], path.ddq[span], path.dddq[span]
        _keep_largest(acceleration[:n], ddq * r**2 + dq * dr)
        _keep_largest(jerk[:n], dddq * r**3 + ddq * (3 * r * dr) + dq * ddr)
    return _Worst(acceleration, jerk)


def _torques(load: Load, start: int, end: int, T: float) -> np.ndarray:
    """Torque over stops that begin at coarse grid points start .. end - 1, largest absolute value (starts, dof)."""
    torque = np.zeros((end - start, load.gravity.shape[1]))
    for offset, r, dr, _ in _ramp(T, load.step_s):
        span = slice(start + offset, min(end + offset, len(load.gravity)))
        n = span.stop - span.start
        if n <= 0:
            break
        _keep_largest(torque[:n], load.gravity[span] + load.path[span] * r**2 + load.inertia[span] * dr)
    return torque


def _keep_largest(largest: np.ndarray, values: np.ndarray) -> None:
    np.maximum(largest, np.abs(values, out=values), out=largest)


def _no_stop(
    path: Path,
    load: Load,
    span: tuple[int, int],
    at_s: float,
    longest_s: float,
    limits: JointLimits,
    tau_limit: np.ndarray,
    joint_names: tuple[str, ...],
) -> CommandRefusedError:
    """The refusal for a segment: what the longest stop would need, whichever quantity is farthest outside."""
    worst = _motion(path, *span, longest_s)
    low, high = span[0] // _TORQUE_STRIDE, (span[1] - 1) // _TORQUE_STRIDE + 1
    rows = (
        ("acceleration", "rad/s²", worst.acceleration.max(axis=0), ALLOWANCE * limits.ddq_max),
        ("jerk", "rad/s³", worst.jerk.max(axis=0), ALLOWANCE * limits.dddq_max),
        ("torque", "N·m", _torques(load, low, high, longest_s).max(axis=0), tau_limit),
    )
    name, unit, values, bounds = max(rows, key=lambda row: float((row[2] / row[3]).max()))
    joint = int(np.argmax(values / bounds))
    return CommandRefusedError(
        Refusal.NO_STOP_PATH,
        f"joint '{joint_names[joint]}' (index {joint}): a stop begun at {at_s:.3f} s would need {name} "
        f"{values[joint]:.4g} {unit} even over {longest_s:g} s, allowed are {bounds[joint]:.4g} {unit}; "
        "plan with more headroom",
        joint=joint_names[joint],
        t=at_s,
        quantity=name,
        value=float(values[joint]),
        limit=float(bounds[joint]),
    )
