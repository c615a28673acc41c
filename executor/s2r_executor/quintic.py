"""Quintic Hermite splines: control points for bounds, evaluation on any grid.

Each segment joins two knots of position, velocity and acceleration. In Bernstein form every derivative lies inside
the hull of its control points, which makes bounds exact by subdivision (:mod:`s2r_executor.extrema`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_executor import _native


@dataclass(frozen=True, eq=False)
class Spline:
    """A piecewise quintic through knots.

    Attributes:
        t: Knot times [s], strictly rising, shape (n,).
        q, dq, ddq: Knot values, shape (n, dof).
        coefficients: Power-basis coefficients per segment in local time [s], lowest first, shape (n - 1, 6, dof).
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    coefficients: np.ndarray

    @property
    def duration_s(self) -> float:
        """From the first knot to the last."""
        return float(self.t[-1] - self.t[0])


def spline_through(t: np.ndarray, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> Spline:
    """The spline through the given knots; see :class:`Spline` for shapes and units."""
    h = np.diff(t)[:, None]
    step, v0, v1, a0, a1 = np.diff(q, axis=0), dq[:-1], dq[1:], ddq[:-1], ddq[1:]
    coefficients = np.stack(
        [
            q[:-1],
            v0,
            a0 / 2,
            (20 * step - (8 * v1 + 12 * v0) * h - (3 * a0 - a1) * h**2) / (2 * h**3),
            (-30 * step + (14 * v1 + 16 * v0) * h + (3 * a0 - 2 * a1) * h**2) / (2 * h**4),
            (12 * step - 6 * (v1 + v0) * h - (a0 - a1) * h**2) / (2 * h**5),
        ],
        axis=1,
    )
    return Spline(t, q, dq, ddq, coefficients)


def minimum_jerk(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The way from 0 to 1 over x in [0, 1], at rest at both ends (Flash and Hogan 1985), and its two derivatives."""
    s = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return s, 30.0 * x**2 * (1.0 - x) ** 2, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)


def control_points(spline: Spline) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Bernstein control points of position, velocity, acceleration and jerk.

    Returns:
        Four arrays of shape (n - 1, 6 .. 3, dof). Positions are absolute; the others are formed from differences
        relative to the segment's first knot, which keeps rounding small for short segments.
    """
    h = np.diff(spline.t)[:, None]
    v0, v1 = spline.dq[:-1], spline.dq[1:]
    a0, a1 = spline.ddq[:-1], spline.ddq[1:]
    end = np.diff(spline.q, axis=0)
    relative = np.stack(
        [
            np.zeros_like(end),
            h * v0 / 5,
            2 * h * v0 / 5 + h**2 * a0 / 20,
            end - 2 * h * v1 / 5 + h**2 * a1 / 20,
            end - h * v1 / 5,
            end,
        ],
        axis=1,
    )
    width = h[:, :, None]
    velocity = 5 * np.diff(relative, axis=1) / width
    acceleration = 4 * np.diff(velocity, axis=1) / width
    jerk = 3 * np.diff(acceleration, axis=1) / width
    position = relative + spline.q[:-1, None, :]
    position[:, 0], position[:, -1] = spline.q[:-1], spline.q[1:]  # exact at the knots
    return position, velocity, acceleration, jerk


@dataclass(frozen=True, eq=False)
class Samples:
    """Values of a spline at given times, each of shape (m, dof)."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    dddq: np.ndarray


def sample(spline: Spline, t: np.ndarray) -> Samples:
    """Evaluate at times [s] of shape (m,); times outside the spline take the nearest end."""
    inside = np.clip(t, spline.t[0], spline.t[-1])
    return Samples(inside, *_native.sample_polynomials(spline.t, spline.coefficients, inside))
