"""Fits of a fixed set of terms: normal equations kept, coefficients, and what is left over on all rows."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from s2r_host.gap.regression.design import Design
from s2r_host.gap.regression.evidence import Marginal, Weighed, Whitener
from s2r_host.gap.regression.normal_equations import Gram, constrained
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Term

TEMPER = 3.0
GRAMS_KEPT = 400
# Friction whose size a new session changes together with the dry and viscous one.
SHAPED_FRICTION = ("stribeck", "presliding", "load_dependent_friction", "asymmetric_friction")


def unwhiten(rows: np.ndarray, w: Whitener) -> np.ndarray:
    """Whitened rows of one block back to effort units."""
    return np.asarray(lfilter([w.scale], np.concatenate([[1.0], -w.coefficients]), rows))


class Regression(Design):
    """Solves for the coefficients of given terms beside the base parameters."""

    def __init__(self, problem: Problem, skip: frozenset[str] = frozenset()) -> None:
        super().__init__(problem, skip)
        self._grams: dict[tuple[Term, ...], Gram] = {}

    def forget(self) -> None:
        """Drop what was stored after the problem's rows were scaled anew."""
        super().forget()
        self._grams.clear()

    def weigh(self, base: Marginal, rows: np.ndarray, term: Term) -> tuple[Weighed, np.ndarray]:
        """A term on top of a marginal made from the rows of a mask; also its prior deviations."""
        s = self.stored(term)
        if s.joint < 0:
            return base.weigh(s.C[rows], s.positive, None if s.fixed is None else s.fixed[rows]), s.prior
        own = self.rows_of[s.joint]
        inside = rows[own]
        if not base.knows(s.joint):
            base.part(s.joint, (np.cumsum(rows) - 1)[own[inside]])
        fixed = None if s.fixed is None else s.fixed[inside]
        return base.weigh(s.C[inside], s.positive, fixed, s.joint), s.prior

    def gram(self, terms: tuple[Term, ...]) -> Gram:
        """Normal equations, built up term by term."""
        found = self._grams.get(terms)
        if found is None:
            p = self.problem
            fit = ~p.held
            if not terms:
                B = p.B[fit]
                found = Gram(B.T @ B, B.T @ p.y[fit], p.prior, np.zeros(p.B.shape[1], dtype=bool))
            else:
                found = self._extended(self.gram(terms[:-1]), terms)
            if len(terms) < 2 or len(self._grams) < GRAMS_KEPT:
                self._grams[terms] = found
        return found

    def _extended(self, before: Gram, terms: tuple[Term, ...]) -> Gram:
        p, s = self.problem, self.stored(terms[-1])
        rows = np.flatnonzero(~p.held) if s.joint < 0 else self.rows_of[s.joint]
        inside = np.ones(len(rows), dtype=bool) if s.joint < 0 else ~p.held[rows]
        at = rows[inside]
        C = s.C[at] if s.joint < 0 else s.C[inside]
        fixed = None if s.fixed is None else (s.fixed[at] if s.joint < 0 else s.fixed[inside])
        y, old = p.y[at], [p.B[at]]
        for t in terms[:-1]:
            D, f, _, _ = self.matrix(t)
            old.append(D[at])
            y = y if f is None else y - f[at]
        B = np.concatenate(old, axis=1)
        g = before.g
        if fixed is not None:
            g, y = g - B.T @ fixed, y - fixed
        W = B.T @ C
        return Gram(
            np.block([[before.G, W], [W.T, C.T @ C]]),
            np.concatenate([g, C.T @ y]),
            np.concatenate([before.deviation, s.prior]),
            np.concatenate([before.positive, s.positive]),
        )

    def fitted(self, terms: list[Term], noise: float) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients as :meth:`solve` finds them, and the leftover on all rows."""
        p, gram = self.problem, self.gram(tuple(terms))
        deviation = gram.deviation.copy()
        deviation[: p.B.shape[1]] = p.prior_at(self.looseness)
        x, _ = constrained(gram.G, gram.g, deviation, gram.positive, noise)
        left, start = p.y - p.B @ x[: p.B.shape[1]], p.B.shape[1]
        for term in terms:
            s = self.stored(term)
            stop = start + s.C.shape[1]
            taken = s.C @ x[start:stop] + (0.0 if s.fixed is None else s.fixed)
            if s.joint < 0:
                left = left - taken
            else:
                left[self.rows_of[s.joint]] -= taken
            start = stop
        return x, left

    def marginal(self, terms: list[Term], rows: np.ndarray, noise: float) -> Marginal:
        """Nuisance plus chosen terms, on the rows of a mask."""
        p = self.problem
        y, parts, prior = p.y[rows], [p.B[rows]], [p.prior_at(self.looseness)]
        for term in terms:
            C, fixed, _, deviation = self.matrix(term)
            parts.append(C[rows])
            prior.append(deviation)
            if fixed is not None:
                y = y - fixed[rows]
        return Marginal(y, np.concatenate(parts, axis=1), np.concatenate(prior), noise)

    def solve(self, terms: list[Term], noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Posterior mean on the fit rows, with sign constraints; returns coefficients, columns, target, covariance."""
        p = self.problem
        fit = ~p.held
        y, parts, prior = p.y, [p.B], [p.prior_at(self.looseness)]
        positive = [np.zeros(p.B.shape[1], dtype=bool)]
        for term in terms:
            C, fixed, sign, deviation = self.matrix(term)
            parts.append(C)
            prior.append(deviation)
            positive.append(sign)
            if fixed is not None:
                y = y - fixed
        B, deviation, sign = np.concatenate(parts, axis=1), np.concatenate(prior), np.concatenate(positive)
        Bf, yf = B[fit], y[fit]
        x, covariance = constrained(Bf.T @ Bf, Bf.T @ yf, deviation, sign, noise)
        return x, B, y, covariance

    def noise_level(self, terms: list[Term]) -> float:
        """Working variance per whitened row for a set of terms: their misfit, at least the floor, tempered."""
        p = self.problem
        fit = ~p.held
        base = self.marginal(terms, fit, TEMPER)
        return TEMPER * max(1.0, base.rss / max(int(fit.sum()), 1))

    def without_drift(self, left: np.ndarray, noise: float, found: np.ndarray | None = None) -> np.ndarray:
        """Leftover with the friction change of each new held-out session taken out."""
        if not self.problem.drift:
            return left
        left = left.copy()
        for drift in self.problem.drift:
            change, _, _, columns = drift.estimate(left, noise, found)
            left[drift.rows] -= columns @ change
        return left

    def added_friction(self, terms: list[Term], x: np.ndarray) -> np.ndarray | None:
        """Whitened friction that terms beyond dry and viscous friction add, shape (rows,), or None."""
        if not self.problem.drift or not any(t.effect in SHAPED_FRICTION for t in terms):
            return None
        total, start = np.zeros(len(self.problem.y)), self.problem.B.shape[1]
        for term in terms:
            C, fixed, _, _ = self.matrix(term)
            stop = start + C.shape[1]
            if term.effect in SHAPED_FRICTION:
                total += C @ x[start:stop] + (0.0 if fixed is None else fixed)
            start = stop
        return total

    def unwhitened(self, left: np.ndarray) -> np.ndarray:
        """Whitened rows back to effort units, block by block."""
        out = np.zeros_like(left)
        for block in self.problem.blocks:
            rows = (left / self.problem.weight)[block.rows]
            out[block.rows] = unwhiten(rows, self.problem.whiteners[block.joint])
        return out
