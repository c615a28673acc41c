"""The motion between the rows of a recording, from what its rows say of position and speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array, diags_array, eye_array
from scipy.sparse.linalg import splu

DEGREE = 5
ROUNDS = 4
STEP_NOISE = 0.45  # deviation of a quantised position, in steps: a third of a step before, uniform after


@dataclass(frozen=True)
class Motion:
    """Position, speed and acceleration of one channel at given times, shape (time,) each."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


def motion(spline: BSpline, t: np.ndarray) -> Motion:
    """The motion along a spline, held beyond its ends."""
    t = np.clip(t, spline.t[DEGREE], spline.t[-DEGREE - 1])
    return Motion(np.asarray(spline(t)), np.asarray(spline(t, 1)), np.asarray(spline(t, 2)))


def smoothing_spline(
    t: np.ndarray, q: np.ndarray, dq: np.ndarray, noise: float, exact: bool = False
) -> BSpline:
    """Smoothing spline through positions and speeds: least squares with a penalty on jerk.

    The weight of the penalty is what makes it the posterior mean of a motion driven by white jerk (Wahba, Spline
    Models for Observational Data, 1990); its power and the noise of the speed are read from the fit, in a few rounds.

    Args:
        t: Rows [s], shape (rows,).
        q, dq: Position and speed, shape (rows,).
        noise: Deviation of the position.
        exact: Position and speed hold no noise.
    """
    knots = np.concatenate([[t[0]] * DEGREE, t, [t[-1]] * DEGREE])
    middle = 0.5 * (t[1:] + t[:-1])
    Q, V = _design(knots, t, 0), _design(knots, t, 1)
    J = _design(knots, np.stack([0.75 * t[:-1] + 0.25 * t[1:], middle], axis=1).ravel(), 3)
    width = np.repeat(0.5 * np.diff(t), 2)
    step = float(np.median(np.diff(t)))
    top = float(np.max(np.abs(dq))) + 1e-9
    power = float(np.mean(np.diff(np.gradient(dq, t)) ** 2)) / step + 1e-12
    noise = max(noise, 1e-9 * (float(np.ptp(q)) + 1e-9))
    noise_v = 1e-6 * top if exact else 1e-3 * top
    probe = np.where(np.arange(len(t)) * 0.5 * (5.0**0.5 - 1.0) % 1.0 < 0.5, 1.0, -1.0)
    coefficients = np.zeros(len(knots) - DEGREE - 1)
    for _ in range(1 if exact else ROUNDS):
        weak = 1e-3 if exact else 1.0
        A = Q.T @ Q / noise**2 + V.T @ V / noise_v**2 + J.T @ diags_array(weak * width / power) @ J
        right = [Q.T @ q / noise**2 + V.T @ dq / noise_v**2, V.T @ probe / noise_v**2]
        coefficients, response = splu(A.tocsc()).solve(np.stack(right, axis=1)).T
        left = dq - V @ coefficients
        free = max(
            len(t) - float(probe @ (V @ response)), 0.02 * len(t)
        )  # Hutchinson's estimate of the trace
        noise_v = max(float(np.sqrt(left @ left / free)), 1e-5 * top)
    return BSpline(knots, coefficients, DEGREE)


def _design(knots: np.ndarray, x: np.ndarray, order: int) -> csr_array:
    """Basis functions, or their derivatives, at each x: sparse, shape (x, coefficients)."""
    change = eye_array(len(knots) - DEGREE - 1, format="csr")
    for k in range(DEGREE, DEGREE - order, -1):
        cut = DEGREE - k
        inner = knots[cut : len(knots) - cut]
        scale = k / np.maximum(inner[k + 1 : -1] - inner[1 : -k - 1], 1e-12)
        edge = eye_array(len(scale), len(scale) + 1, k=1) - eye_array(len(scale), len(scale) + 1)
        change = diags_array(scale) @ edge @ change
    inner = knots[order : len(knots) - order] if order else knots
    return csr_array(BSpline.design_matrix(x, inner, DEGREE - order) @ change)
