"""From the critic's logits to shares of pushes that are useful (Platt 1999)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

BINS = 10


@dataclass(frozen=True)
class Calibration:
    """Likelihood = sigmoid(slope * logit + offset)."""

    slope: float = 1.0
    offset: float = 0.0

    def likelihood(self, logit: NDArray[np.floating]) -> NDArray[np.floating]:
        """Shares, 0 to 1."""
        return 1.0 / (1.0 + np.exp(-(self.slope * logit + self.offset)))


def calibrate(logit: NDArray[np.floating], truth: NDArray[np.bool_]) -> Calibration:
    """The calibration of greatest likelihood; none if there is one sort of outcome only or the logit says nothing."""
    if truth.all() or not truth.any():
        return Calibration()
    sign = np.where(truth, 1.0, -1.0)

    def loss(x: NDArray[np.floating]) -> float:
        return float(np.logaddexp(0.0, -sign * (x[0] * logit + x[1])).mean())

    slope, offset = minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead").x
    return Calibration(float(slope), float(offset)) if slope > 0 else Calibration()


def expected_error(likelihood: NDArray[np.floating], truth: NDArray[np.bool_]) -> float:
    """Expected calibration error in ten bins (Guo et al. 2017): mean distance between promised and kept."""
    of = np.minimum((likelihood * BINS).astype(int), BINS - 1)
    gaps = (abs(float((likelihood[of == b] - truth[of == b]).sum())) for b in range(BINS))
    return sum(gaps) / len(truth)


def area_under_curve(score: NDArray[np.floating], truth: NDArray[np.bool_]) -> float:
    """Probability that a useful push scores above a useless one, a tie counting half; 0.5 if there is only one sort."""
    good, bad = score[truth], np.sort(score[~truth])
    if len(good) == 0 or len(bad) == 0:
        return 0.5
    below, up_to = np.searchsorted(bad, good, "left"), np.searchsorted(bad, good, "right")
    return float(np.mean(below + up_to) / (2 * len(bad)))
