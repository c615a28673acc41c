"""Sets of effects against the rows: whitened columns kept, fits of a fixed set, and what they leave over."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from s2r_host.gap.base_terms import base_terms
from s2r_host.gap.complete import LinkGroup
from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Effect
from s2r_host.gap.evidence import Marginal, Whitener
from s2r_host.gap.problem import Problem
from s2r_host.gap.solution import Scored, Solution, Term

TEMPER = 3.0
FLOOR_SLACK = 1.2
FLOOR_SLACK_AFTER = 1.4
# Leftover common to two runs of one motion: correlation, and power in noise floors (clean recordings stay below 0.45).
COMMON_CORRELATION, COMMON_POWER = 0.35, 0.55
LEAST_ROWS = 60
# Friction whose size a new session changes together with the dry and viscous one.
SHAPED_FRICTION = ("stribeck", "presliding", "load_dependent_friction", "asymmetric_friction")


def unwhiten(rows: np.ndarray, w: Whitener) -> np.ndarray:
    """Whitened rows of one block back to effort units."""
    return np.asarray(lfilter([w.scale], np.concatenate([[1.0], -w.coefficients]), rows))


class Regression:
    """Keeps whitened columns, so that the same shape is never filtered twice."""

    def __init__(
        self,
        problem: Problem,
        skip: frozenset[str] = frozenset(),
    ) -> None:
        self.problem = problem
        self.looseness = 1.0
        self.effects: dict[str, Effect] = {n: e for n, e in catalogue().items() if n not in skip}
        self.effects |= base_terms(problem.base)
        self._columns: dict[Term, tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]] = {}
        self.effort_rms = float(np.sqrt(np.mean(problem.effort**2))) + 1e-12

    def forget(self) -> None:
        """Drop stored columns after the problem's rows were scaled anew."""
        self._columns.clear()
        self.effort_rms = float(np.sqrt(np.mean(self.problem.effort**2))) + 1e-12

    def matrix(self, term: Term) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]:
        """Whitened columns, fixed column, sign mask, prior deviations of a term."""
        stored = self._columns.get(term)
        if stored is None:
            effect = self.effects[term.effect]
            shape = dict(term.shape)
            sessions = {b.session.index: b.session for b in self.problem.blocks}
            per_session = {
                k: effect.columns(self.problem.ctx, s, term.joint, shape) for k, s in sessions.items()
            }
            C, fixed = self.problem.columns(per_session, term.joint)
            first = next(iter(per_session.values()))
            positive = np.array(first.positive or (False,) * C.shape[1], dtype=bool)
            size = np.sqrt(np.mean(C**2, axis=0)) + 1e-12 * self.effort_rms
            prior = effect.deviations() if isinstance(effect, LinkGroup) else 0.5 * self.effort_rms / size
            stored = self._columns[term] = (C, fixed, positive, prior)
        return stored

    def marginal(self, terms: list[Term], rows: np.ndarray, noise: float) -> Marginal:
        """Nuisance plus chosen terms, on the rows of a mask."""
        p = self.problem
        y, parts, prior = p.y[rows], [p.B[rows]], [p.prior * self.looseness]
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
        y, parts, prior = p.y, [p.B], [p.prior * self.looseness]
        positive = [np.zeros(p.B.shape[1], dtype=bool)]
        for term in terms:
            C, fixed, sign, deviation = self.matrix(term)
            parts.append(C)
            prior.append(deviation)
            positive.append(sign)
            if fixed is not None:
                y = y - fixed
        B, deviation, sign = np.concatenate(parts, axis=1), np.concatenate(prior), np.concatenate(positive)
        active = np.ones(B.shape[1], dtype=bool)
        x, covariance = np.zeros(B.shape[1]), np.zeros((B.shape[1], B.shape[1]))
        Bf, yf = B[fit], y[fit]
        G, g = Bf.T @ Bf, Bf.T @ yf
        for _ in range(8):
            a = np.ix_(active, active)
            A = G[a] + np.diag(noise / deviation[active] ** 2)
            x = np.zeros(B.shape[1])
            inverse = np.linalg.inv(A)
            x[active] = inverse @ g[active]
            covariance[:] = 0.0
            covariance[a] = noise * inverse
            wrong = active & sign & (x < 0)
            if not wrong.any():
                break
            active &= ~wrong
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
            left[drift.block.rows] -= columns @ change
        return left

    def added_friction(self, terms: list[Term], x: np.ndarray, B: np.ndarray) -> np.ndarray | None:
        """Whitened friction that terms beyond dry and viscous friction add, shape (rows,), or None."""
        if not self.problem.drift or not any(t.effect in SHAPED_FRICTION for t in terms):
            return None
        total, start = np.zeros(len(B)), self.problem.B.shape[1]
        for term in terms:
            C, fixed, _, _ = self.matrix(term)
            stop = start + C.shape[1]
            if term.effect in SHAPED_FRICTION:
                total += B[:, start:stop] @ x[start:stop] + (0.0 if fixed is None else fixed)
            start = stop
        return total

    def at_floor(self, chosen: list[Term]) -> bool:
        """Is what is left over indistinguishable from the noise floor, on fitted and on held-out rows?"""
        p = self.problem
        x, B, y, _ = self.solve(chosen, self.noise_level(chosen))
        left = self.without_drift(y - B @ x, TEMPER, self.added_friction(chosen, x, B))
        raw = self.unwhitened(left)
        slack = FLOOR_SLACK_AFTER if chosen else FLOOR_SLACK
        for block in p.blocks:
            for mask in (block.held, ~block.held):
                if mask.any() and p.rms(raw, block, mask) > slack * p.floor[block.joint]:
                    return False
        return not self.comes_back(chosen)

    def comes_back(self, chosen: list[Term]) -> bool:
        """Does what the terms leave over come back in the second run of the motion? Then it is no noise."""
        twin = self.problem.twin
        if twin is None:
            return False
        x, own, y, _ = self.solve(chosen, self.noise_level(chosen))
        raw = self.unwhitened(y - own @ x)
        second = twin.problem
        parts, y = [second.B], second.y
        sessions = {b.session.index: b.session for b in second.blocks}
        for term in chosen:
            effect, shape = self.effects[term.effect], dict(term.shape)
            columns = {k: effect.columns(self.problem.ctx, s, term.joint, shape) for k, s in sessions.items()}
            C, fixed = second.columns(columns, term.joint)
            parts.append(C)
            y = y if fixed is None else y - fixed
        left = y - np.concatenate(parts, axis=1) @ x
        for first, again in twin.pairs:
            a = raw[first.rows] * self.problem.weight[first.rows]
            b = unwhiten(left[again.rows] / second.weight[again.rows], second.whiteners[again.joint])
            b = b * second.weight[again.rows]
            n = min(len(a), len(b))
            if n < LEAST_ROWS:
                continue
            correlation = float(np.corrcoef(a[:n], b[:n])[0, 1])
            power = float(np.mean(a[:n] * b[:n])) / self.problem.floor[first.joint] ** 2
            if correlation > COMMON_CORRELATION and power > COMMON_POWER:
                return True
        return False

    def finish(self, chosen: list[Term], slots: list[list[Scored]], scans: list[Scored]) -> Solution:
        """Coefficients, covariance and misfits of the final set."""
        p = self.problem
        noise = self.noise_level(chosen)
        x, B, y, covariance = self.solve(chosen, noise)
        nb = p.B.shape[1]
        thetas, covariances, start = [], [], nb
        for term in chosen:
            k = self.matrix(term)[0].shape[1]
            thetas.append(x[start : start + k])
            covariances.append(covariance[start : start + k, start : start + k])
            start += k
        raw_drifted = y - B @ x
        found = self.added_friction(chosen, x, B)
        drift = [d.estimate(raw_drifted, noise, found)[:3] for d in p.drift]
        left = self.without_drift(raw_drifted, noise, found)
        y0 = p.y
        fit, held = ~p.held, p.held

        def mean2(v: np.ndarray, mask: np.ndarray) -> float:
            return float(np.mean(v[mask] ** 2)) if mask.any() else float("nan")

        raw_left = self.unwhitened(left)
        return Solution(
            chosen, slots, thetas, covariances, x[:nb], np.sqrt(np.maximum(np.diag(covariance)[:nb], 0.0)), noise,
            (mean2(y0, fit), mean2(left, fit)), (mean2(y0, held), mean2(left, held)),
            (mean2(p.raw, fit), mean2(raw_left, fit)), (mean2(p.raw, held), mean2(raw_left, held)),
            raw_left, drift, self.unwhitened(raw_drifted), scans,
        )  # fmt: skip

    def unwhitened(self, left: np.ndarray) -> np.ndarray:
        """Whitened rows back to effort units, block by block."""
        out = np.zeros_like(left)
        for block in self.problem.blocks:
            rows = (left / self.problem.weight)[block.rows]
            out[block.rows] = unwhiten(rows, self.problem.whiteners[block.joint])
        return out
