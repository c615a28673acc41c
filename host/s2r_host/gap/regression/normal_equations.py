"""Normal equations of a set of terms, their extension by one term, and their solution under sign constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gram:
    """Normal equations of base parameters and terms on the fit rows.

    Attributes:
        G: Columns by columns.
        g: Columns by target, what terms hold fixed taken off.
        deviation, positive: Prior deviation and sign mask of each column.
    """

    G: np.ndarray
    g: np.ndarray
    deviation: np.ndarray
    positive: np.ndarray


def constrained(
    G: np.ndarray, g: np.ndarray, deviation: np.ndarray, sign: np.ndarray, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean and covariance under sign constraints: coefficients of the wrong sign are set to zero."""
    n = len(g)
    active = np.ones(n, dtype=bool)
    x, covariance = np.zeros(n), np.zeros((n, n))
    for _ in range(8):
        a = np.ix_(active, active)
        A = G[a] + np.diag(noise / deviation[active] ** 2)
        x = np.zeros(n)
        inverse = np.linalg.inv(A)
        x[active] = inverse @ g[active]
        covariance[:] = 0.0
        covariance[a] = noise * inverse
        wrong = active & sign & (x < 0)
        if not wrong.any():
            break
        active &= ~wrong
    return x, covariance
