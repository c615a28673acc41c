"""Terms of an explanation, how they weigh, and the fitted whole."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Term:
    """One effect on one joint (-1: on all of them) at one shape."""

    effect: str
    joint: int
    shape: tuple[tuple[str, float], ...] = ()

    @property
    def key(self) -> tuple[str, int]:
        """Effect and joint, without the shape."""
        return self.effect, self.joint


@dataclass
class Scored:
    """A term weighed against the terms already chosen.

    Attributes:
        score: Log evidence on the fit rows plus log prediction on the held-out rows.
        gain: Score minus the score without the term.
        holdout_gain: Share of the held-out misfit (unwhitened) the term removes.
        theta: Coefficients of its columns.
        refuted: Gain it had before the held-out rows spoke against it; zero where they did not.
    """

    term: Term
    score: float
    gain: float
    holdout_gain: float
    theta: np.ndarray
    refuted: float = 0.0


@dataclass
class Solution:
    """Chosen terms with coefficients, alternatives and misfits.

    Attributes:
        terms: Chosen terms.
        slots: Per term: everything that was weighed for its place, best first.
        theta: Per term its coefficients.
        covariance: Per term the posterior covariance of its coefficients.
        base, base_deviation: Posterior of the base parameters: means and standard deviations.
        noise: Working variance of a whitened row.
        raw_held: Mean square of held-out rows before and after [(N·m)² or N²].
        unexplained: Rows that are left over, without what numbers in doubt may hold, shape (rows,) [N·m or N].
        drift: Per drift of the problem its change, covariance and level.
        scans: What was weighed for the first term's place.
    """

    terms: list[Term]
    slots: list[list[Scored]]
    theta: list[np.ndarray]
    covariance: list[np.ndarray]
    base: np.ndarray
    base_deviation: np.ndarray
    noise: float
    raw_held: tuple[float, float]
    unexplained: np.ndarray
    drift: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)
    scans: list[Scored] = field(default_factory=list)
