"""Bayesian comparison of explanations for the effort residual, with coloured noise and nuisance parameters.

The residual of all joints and recordings is one vector y. Base parameters (masses, centres, friction of the
nominal model) enter as nuisance columns B with a weak Gaussian prior and are marginalised; an explanation is a
set of columns C with a wide prior. Rows are whitened with an autoregressive noise model per joint, so that
n rows count as n samples. See Bishop, Pattern Recognition and Machine Learning (2006), section 3.5.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_factor, solve_toeplitz
from scipy.linalg.lapack import dpotrs
from scipy.signal import lfilter

AR_ORDER = 4


@dataclass(frozen=True)
class Whitener:
    """Autoregressive noise model of one joint: ``coefficients`` of 1 - sum a_k z^-k, ``scale`` its innovation."""

    coefficients: np.ndarray
    scale: float

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Whiten and scale to unit variance, along the first axis."""
        return np.asarray(lfilter(np.concatenate([[1.0], -self.coefficients]), [1.0], x, axis=0)) / self.scale


def fit_whitener(samples: list[np.ndarray], scale_floor: float, order: int = AR_ORDER) -> Whitener:
    """Yule-Walker fit to noise samples (one array per recording).

    Args:
        samples: Noise, each of shape (time,).
        scale_floor: Smallest believable innovation (quantisation) in effort units.
        order: Order of the model.
    """
    lags = np.zeros(order + 1)
    n = 0
    for x in samples:
        x = x - np.mean(x)
        lags += np.array([x[: len(x) - k] @ x[k:] for k in range(order + 1)])
        n += len(x)
    lags /= max(n, 1)
    if lags[0] <= 0:
        return Whitener(np.zeros(order), max(scale_floor, 1e-12))
    lags[0] *= 1.0 + 1e-2  # a touch of white noise keeps the whitening filter from blowing up out of band
    coefficients = solve_toeplitz(lags[:-1], lags[1:])
    innovation = float(lags[0] - coefficients @ lags[1:])
    return Whitener(coefficients, max(np.sqrt(max(innovation, 1e-18)), scale_floor, 1e-12))


@dataclass
class Marginal:
    """y and nuisance columns, ready to weigh further columns.

    Attributes:
        y: Whitened residual, shape (rows,).
        B: Whitened nuisance columns, shape (rows, k).
        prior: Prior standard deviation of each nuisance coefficient, shape (k,).
        noise: Variance of a whitened row under the working noise level.
    """

    y: np.ndarray
    B: np.ndarray
    prior: np.ndarray
    noise: float = 1.0
    _parts: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.B.shape[1]:
            self._factor = cho_factor(self.B.T @ self.B + np.diag(self.noise / self.prior**2))
            self._Py = self.y - self.B @ self._solved(self.B.T @ self.y)
        else:
            self._Py = self.y
        self._rss = float(self.y @ self._Py)

    def _solved(self, b: np.ndarray) -> np.ndarray:
        """As ``cho_solve`` does it, without its checks: they take longer than the solution of a few unknowns."""
        return dpotrs(self._factor[0], b, lower=self._factor[1])[0]

    def knows(self, name: int) -> bool:
        """Were the rows of this name announced?"""
        return name in self._parts

    def part(self, name: int, at: np.ndarray) -> None:
        """Announce rows that columns may be confined to (those of one joint), as indices into ``y``."""
        self._parts[name] = (self.B[at], at)

    @property
    def rss(self) -> float:
        """Misfit of the nuisance alone, prior included."""
        return self._rss

    def weigh(
        self, C: np.ndarray, positive: np.ndarray, fixed: np.ndarray | None, part: int | None = None
    ) -> Weighed:
        """Fit columns on top of the nuisance; coefficients with a wrong sign are set to zero.

        Args:
            C: Whitened columns, shape (rows, k); with ``part`` only its rows, all others being zero.
            positive: Mask of coefficients that must not be negative, shape (k,).
            fixed: Whitened column with coefficient one, or None.
            part: Name given to :meth:`part`.
        """
        B, Py = (self.B, self._Py) if part is None else (self._parts[part][0], self._Py[self._parts[part][1]])
        S, m, rss = C.T @ C, C.T @ Py, self.rss
        W = B.T @ C
        if B.shape[1]:
            S = S - W.T @ self._solved(W)
        if fixed is not None:
            w = B.T @ fixed
            u = self._solved(w) if B.shape[1] else w
            rss = rss - 2.0 * float(fixed @ Py) + float(fixed @ fixed - w @ u)
            m = m - (C.T @ fixed - W.T @ u)
        if C.shape[1] == 0:
            return Weighed(np.zeros(0), np.zeros((0, 0)), np.zeros(0), rss, np.zeros(0, dtype=bool))
        active = np.ones(C.shape[1], dtype=bool)
        theta = np.zeros(C.shape[1])
        for _ in range(C.shape[1]):
            theta = np.zeros(C.shape[1])
            sub = np.ix_(active, active)
            if active.any():
                ridge = 1e-9 * np.trace(S[sub]) / active.sum() + 1e-300
                theta[active] = np.linalg.solve(S[sub] + ridge * np.eye(active.sum()), m[active])
            wrong = active & positive & (theta < 0)
            if not wrong.any():
                break
            active &= ~wrong
        return Weighed(theta, S, m, rss, active)


@dataclass(frozen=True)
class Weighed:
    """Sufficient statistics of one explanation: S = CᵀPC, m = CᵀPy, coefficients, misfit without it."""

    theta: np.ndarray
    S: np.ndarray
    m: np.ndarray
    rss_without: float
    active: np.ndarray

    @property
    def rss(self) -> float:
        """Misfit with the explanation."""
        return float(self.rss_without - 2.0 * self.m @ self.theta + self.theta @ self.S @ self.theta)

    def log_evidence(self, noise: float, prior: np.ndarray) -> float:
        """Log evidence of y up to a constant shared by all explanations.

        Args:
            noise: Variance of a whitened row, tempering included.
            prior: Prior standard deviation per coefficient, shape (k,).
        """
        a = self.active
        if not a.any():
            return -0.5 * self.rss_without / noise
        S = self.S[np.ix_(a, a)] / noise
        A = S + np.diag(1.0 / prior[a] ** 2)
        m = self.m[a] / noise
        gain = 0.5 * float(m @ np.linalg.solve(A, m))
        _, logdet = np.linalg.slogdet(A)
        occam = -0.5 * (logdet + 2.0 * float(np.sum(np.log(prior[a]))))
        return -0.5 * self.rss_without / noise + gain + occam
