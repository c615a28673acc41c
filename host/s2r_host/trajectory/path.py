"""A smooth joint path through the targets of control steps, without times."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

from s2r_host.trajectory.trajectory import TrajectoryError

_SAME = 1e-5  # rows nearer than this [rad] are one point: a held target has many
# On ways longer than this the usual support points are so far apart that they cut corners by more than the smoothing
# may: there are more of them then, until none is cut by more than that.
_LONG_RAD, _CUT_RAD, _MOST_POINTS = 4.0, 0.004, 8000


def smooth_path(q_path: np.ndarray, deviation_rad: float, points: int = 120) -> CubicSpline:
    """The smoothest path that stays near given points, with the same ends.

    Args:
        q_path: Joint positions [rad], (n, dof).
        deviation_rad: How far any joint may be smoothed away from the straight lines between the points; 0
            interpolates them.
        points: Support points of the smoothing; on a long way doubled until they cut no corner by more than
            ``deviation_rad`` or 4 mrad, whichever is more.

    Returns:
        Spline over path length from 0 [rad]; call it with an order for derivatives.

    Raises:
        TrajectoryError: The path holds numbers that are not finite, or does not move at all.
    """
    q_path = np.asarray(q_path, dtype=float)
    if q_path.ndim != 2 or len(q_path) < 2:
        raise TrajectoryError(
            f"a path needs at least two rows of joint positions; its shape is {q_path.shape}"
        )
    if not np.isfinite(q_path).all():
        row, joint = np.argwhere(~np.isfinite(q_path))[0]
        raise TrajectoryError(
            f"joint index {joint}: q_path[{row}] = {q_path[row, joint]} is not a finite number"
        )
    q = _distinct(q_path)
    if len(q) < 2:
        raise TrajectoryError(f"the path does not move: all {len(q_path)} rows are within {_SAME:g} rad")
    length = _lengths(q)
    if deviation_rad <= 0.0 or len(q) < 3:
        return CubicSpline(length, q, bc_type="natural" if len(q) > 2 else "not-a-knot")
    straight = _evenly(q, length, points)
    most_cut = max(deviation_rad, _CUT_RAD) if length[-1] > _LONG_RAD else np.inf
    while points < _MOST_POINTS and _cut(straight, q, length) > most_cut:
        points *= 2
        straight = _evenly(q, length, points)
    smoothed = _smoothest(straight, deviation_rad)
    return CubicSpline(_lengths(smoothed), smoothed, bc_type="natural")


def length_at(q_path: np.ndarray, row: int) -> float:
    """Share of the path's length, 0 to 1, that lies before a row."""
    length = _lengths(q_path)
    return float(length[row] / length[-1]) if length[-1] > 0.0 else 0.0


def _evenly(q: np.ndarray, length: np.ndarray, points: int) -> np.ndarray:
    """Evenly spaced points on the straight lines through rows at some lengths, (points, dof)."""
    even = np.linspace(0.0, length[-1], points)
    return np.column_stack([np.interp(even, length, joint) for joint in q.T])


def _cut(straight: np.ndarray, q: np.ndarray, length: np.ndarray) -> float:
    """How far the straight lines through evenly spaced points pass the rows that they stand for, in any joint [rad]."""
    even = np.linspace(0.0, length[-1], len(straight))
    return float(np.abs(np.column_stack([np.interp(length, even, joint) for joint in straight.T]) - q).max())


def _smoothest(q: np.ndarray, deviation_rad: float) -> np.ndarray:
    """Least third differences over the rows of q that deviate no more than allowed; the ends stay where they are."""
    low, high = 0.0, 9.0  # decimal exponents of the smoothing weight
    best = q
    for _ in range(14):
        middle = (low + high) / 2.0
        trial = _penalised(q, 10.0**middle)
        if np.abs(trial - q).max() <= deviation_rad:
            best, low = trial, middle
        else:
            high = middle
    return best


def _penalised(q: np.ndarray, weight: float) -> np.ndarray:
    """Minimum of |x - q|² + weight |third difference of x|², the two ends held by a large weight."""
    n = len(q)
    band = np.zeros((4, n))
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    for offset in range(4):
        products = stencil[: 4 - offset] * stencil[offset:]
        for k, value in enumerate(products):
            band[offset, k : k + n - 3] += weight * value
    hold = np.ones(n)
    hold[[0, -1]] = 1e9 * max(weight, 1.0)
    band[0] += hold
    smoothed = solveh_banded(band, hold[:, None] * q, lower=True)
    smoothed[[0, -1]] = q[[0, -1]]
    return smoothed


def _distinct(q: np.ndarray) -> np.ndarray:
    """Rows without repetitions; the last row always stays."""
    kept = [q[0]]
    for row in q[1:]:
        if np.abs(row - kept[-1]).max() > _SAME:
            kept.append(row)
    if len(kept) > 1:
        kept[-1] = q[-1]
    return np.array(kept)


def _lengths(q: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
