"""Does any polynomial of a plan leave its interval? Exact up to rounding, between knots too.

A Bernstein polynomial lies in the hull of its control points, and halving its interval brings the hull four times
closer. So: hull inside the limits = proven inside; an end point outside = proven outside; otherwise halve.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

_MAX_HALVINGS = 40
_MAX_PIECES = 200_000


@dataclass(frozen=True)
class Exceedance:
    """The point of a plan that is farthest outside.

    Attributes:
        segment, joint: Indices.
        fraction: Where in the segment, 0 to 1.
        value: There.
        limit: The bound it crosses.
    """

    segment: int
    joint: int
    fraction: float
    value: float
    limit: float


def find_exceedance(
    control: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    tolerance: np.ndarray,
    outermost: tuple[np.ndarray, np.ndarray] | None = None,
) -> Exceedance | None:
    """Look for a value outside ``[lower - tolerance, upper + tolerance]``.

    Args:
        control: Bernstein control points, shape (segments, degree + 1, dof); finite.
        lower, upper: Per joint, shape (dof,).
        tolerance: Per joint, absorbs rounding, shape (dof,).
        outermost: What :func:`hull` says of the control points, if known already.

    Returns:
        None if every polynomial stays inside on its whole interval; else the worst exceedance, relative to the width
        of the interval.
    """
    low, high = lower - tolerance, upper + tolerance
    largest, smallest = outermost or hull(control)
    if ((largest <= high) & (smallest >= low)).all():  # the ordinary plan; a NaN goes on
        return None
    suspicious = ~((control.max(axis=1) <= high) & (control.min(axis=1) >= low))
    segment, joint = np.nonzero(suspicious)
    if not len(segment):
        return None
    pieces = control[segment, :, joint]
    owners = np.arange(len(segment))
    guilty = _owners_outside(pieces, owners, low[joint], high[joint])
    if not len(guilty):
        return None
    return _worst(control, segment[guilty], joint[guilty], lower, upper)


def hull(control: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest and smallest control point of each joint over the whole plan, two arrays of shape (dof,)."""
    columns = np.ascontiguousarray(control.reshape(-1, control.shape[2]).T)  # reduced five times faster so
    return columns.max(axis=1), columns.min(axis=1)


def _owners_outside(pieces: np.ndarray, owners: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Indices of the polynomials that leave [low, high]; anything still undecided at the end counts as outside."""
    guilty = np.zeros(len(owners), dtype=bool)
    for _ in range(_MAX_HALVINGS):
        ends_out = ~(
            (pieces[:, (0, -1)] <= high[owners, None]) & (pieces[:, (0, -1)] >= low[owners, None])
        ).all(axis=1)
        guilty[owners[ends_out]] = True
        open_question = (
            ~((pieces.max(axis=1) <= high[owners]) & (pieces.min(axis=1) >= low[owners])) & ~guilty[owners]
        )
        pieces, owners = pieces[open_question], owners[open_question]
        if not len(owners) or len(owners) > _MAX_PIECES:
            break
        pieces, owners = _halve(pieces), np.concatenate([owners, owners])
    guilty[owners] = True
    return np.nonzero(guilty)[0]


def _halve(pieces: np.ndarray) -> np.ndarray:
    """de Casteljau at one half: left halves, then right halves."""
    count = pieces.shape[1]
    left, right = np.empty_like(pieces), np.empty_like(pieces)
    level = pieces
    for i in range(count):
        left[:, i], right[:, count - 1 - i] = level[:, 0], level[:, -1]
        level = (level[:, :-1] + level[:, 1:]) / 2
    return np.concatenate([left, right])


def _worst(
    control: np.ndarray, segment: np.ndarray, joint: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> Exceedance:
    """Of the guilty polynomials the one farthest outside, and where: coarse search, then the derivative's roots."""
    degree = control.shape[1] - 1
    x = np.linspace(0.0, 1.0, 33)
    basis = np.array([comb(degree, i) * x**i * (1 - x) ** (degree - i) for i in range(degree + 1)])
    values = control[segment, :, joint] @ basis
    excess = (
        np.maximum(values - upper[joint, None], lower[joint, None] - values) / (upper - lower)[joint, None]
    )
    which = int(np.argmax(excess.max(axis=1)))
    s, j = int(segment[which]), int(joint[which])
    points = control[s, :, j]
    candidates = np.concatenate([[0.0, 1.0], _stationary(points)])
    at = np.array([_evaluate(points, c) for c in candidates])
    best = int(np.argmax(np.maximum(at - upper[j], lower[j] - at)))
    limit = upper[j] if at[best] - upper[j] >= lower[j] - at[best] else lower[j]
    return Exceedance(s, j, float(candidates[best]), float(at[best]), float(limit))


def _evaluate(points: np.ndarray, x: float) -> float:
    level = points
    while len(level) > 1:
        level = level[:-1] * (1 - x) + level[1:] * x
    return float(level[0])


def _stationary(points: np.ndarray) -> np.ndarray:
    """Where the derivative is zero inside (0, 1)."""
    degree = len(points) - 1
    slopes = np.diff(points)
    if not np.isfinite(slopes).all():  # numbers so large that their differences overflow: already outside
        return np.empty(0)
    power = np.zeros(degree)
    for i, slope in enumerate(slopes):
        term = np.poly1d([slope * comb(degree - 1, i)])
        term = term * np.poly1d([1, 0]) ** i * np.poly1d([-1, 1]) ** (degree - 1 - i)
        power[degree - len(term.coeffs) :] += term.coeffs
    roots = np.roots(power)
    real = roots[np.abs(roots.imag) < 1e-9].real
    return real[(real > 0) & (real < 1)]
