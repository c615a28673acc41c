"""Quintic Hermite segments between knots: evaluation and exact extrema.

Between two knots every joint follows the one polynomial of degree five that takes position, velocity and
acceleration at both ends; the executor plays exactly these.
"""

from __future__ import annotations

import functools
from math import comb

import numpy as np

# Rows: coefficients of u^0..u^5, u in [0, 1]; columns: p0, v0 T, a0 T², p1, v1 T, a1 T².
_HERMITE = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0],
        [-10.0, -6.0, -1.5, 10.0, -4.0, 0.5],
        [15.0, 8.0, 1.5, -15.0, 7.0, -1.0],
        [-6.0, -3.0, -0.5, 6.0, -3.0, 0.5],
    ]
)


def coefficients(t: np.ndarray, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """Polynomials of all segments in u = (time since the knot) / T, shape (segments, dof, 6), constant first."""
    T = np.diff(t)[:, None]
    ends = np.stack([q[:-1], dq[:-1] * T, ddq[:-1] * T**2, q[1:], dq[1:] * T, ddq[1:] * T**2], axis=-1)
    # Positions relative to the segment's start: digits that carry the shape are then not lost in large angles.
    offset = q[:-1][..., None]
    ends[..., [0, 3]] -= offset
    result = ends @ _HERMITE.T
    result[..., 0] += q[:-1]
    return result


def derivative(c: np.ndarray, order: int) -> np.ndarray:
    """Coefficients of the derivative with respect to u."""
    for _ in range(order):
        c = c[..., 1:] * np.arange(1, c.shape[-1])
    return c


def evaluate(c: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Values of polynomials (..., n) at u, which broadcasts against the leading shape."""
    value = np.zeros(np.broadcast_shapes(c.shape[:-1], np.shape(u)))
    for k in range(c.shape[-1] - 1, -1, -1):
        value = value * u + c[..., k]
    return value


def bounds(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact minimum and maximum of polynomials (..., n) over u in [0, 1]: at the ends or where they are level."""
    candidates = [np.zeros(c.shape[:-1]), np.ones(c.shape[:-1])]
    slope = derivative(c, 1)
    roots = _roots(slope.reshape(-1, slope.shape[-1])).reshape(*c.shape[:-1], -1)
    # A real root with a rounding error stays a candidate: any u in [0, 1] is a value that is really taken.
    inside = np.where(np.abs(roots.imag) < 1e-6, np.clip(roots.real, 0.0, 1.0), 0.0)
    candidates += list(np.moveaxis(inside, -1, 0))
    values = np.stack([evaluate(c, u) for u in candidates])
    return values.min(axis=0), values.max(axis=0)


def bounds_over(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact minimum and maximum of all segments together, polynomials (segments, dof, n) over u in [0, 1], two (dof,).

    A polynomial stays between the smallest and largest of its Bernstein coefficients (Farouki and Rajan 1987): where
    these do not leave what the segments' ends span already, nobody needs to know where it is level.
    """
    ends = np.stack([c[..., 0], c.sum(axis=-1)])
    low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
    hull = c @ _bernstein(c.shape[-1])
    segment, joint = np.nonzero((hull.min(axis=-1) < low) | (hull.max(axis=-1) > high))
    if len(segment):
        lows, highs = bounds(c[segment, joint])
        np.minimum.at(low, joint, lows)
        np.maximum.at(high, joint, highs)
    return low, high


@functools.cache
def _bernstein(count: int) -> np.ndarray:
    """Takes power coefficients (..., count), constant first, to Bernstein coefficients as a right factor."""
    degree = count - 1
    return np.array(
        [[comb(j, k) / comb(degree, k) if k <= j else 0.0 for j in range(count)] for k in range(count)]
    )


def _roots(c: np.ndarray) -> np.ndarray:
    """Complex roots of polynomials (n, degree + 1), constant first, from their companion matrices."""
    degree = c.shape[1] - 1
    if degree < 1:
        return np.zeros((len(c), 0), dtype=complex)
    scale = np.abs(c).max(axis=1, keepdims=True)
    c = np.where(scale > 0.0, c / np.where(scale > 0.0, scale, 1.0), 0.0)
    # A vanishing leading coefficient sends its root to infinity, which is outside [0, 1] as it should be.
    lead = np.where(np.abs(c[:, -1]) < 1e-9, 1e-9, c[:, -1])
    companion = np.zeros((len(c), degree, degree))
    if degree > 1:
        companion[:, 1:, :-1] = np.eye(degree - 1)
    companion[:, :, -1] = -c[:, :-1] / lead[:, None]
    return np.linalg.eigvals(companion).astype(complex)
