"""Sets of effects against the rows: whitened columns kept, fits of a fixed set, and what they leave over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from s2r_host.gap.base_terms import base_terms, with_directions_held
from s2r_host.gap.complete import LinkGroup
from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Effect
from s2r_host.gap.evidence import Marginal, Weighed, Whitener
from s2r_host.gap.problem import Problem
from s2r_host.gap.solution import Scored, Solution, Term

TEMPER = 3.0
FLOOR_SLACK = 1.2
FLOOR_SLACK_AFTER = 1.4
# Leftover common to two runs of one motion: correlation, and power in noise floors (clean recordings stay below 0.45).
COMMON_CORRELATION, COMMON_POWER = 0.35, 0.55
LEAST_ROWS = 60
GRAMS_KEPT = 400
FEW_JOINTS = 2  # up to here a turned centre of mass and a turned zero are the same
QUIET = 1.12  # noise floors; a joint of an arm with no more than that is not searched
# Friction whose size a new session changes together with the dry and viscous one.
SHAPED_FRICTION = ("stribeck", "presliding", "load_dependent_friction", "asymmetric_friction")


@dataclass(frozen=True)
class Stored:
    """Columns of one term on the rows they touch: those of its joint, or all (``joint`` -1)."""

    joint: int
    C: np.ndarray
    fixed: np.ndarray | None
    positive: np.ndarray
    prior: np.ndarray


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
        self.looseness: float | np.ndarray = 1.0  # of the base parameters' priors, alike or one by one
        self.effects: dict[str, Effect] = {n: e for n, e in catalogue().items() if n not in skip}
        numbers = base_terms(problem.base)
        self.effects |= (
            with_directions_held(numbers) if len(problem.ctx.model.joints) <= FEW_JOINTS else numbers
        )
        self._columns: dict[Term, Stored] = {}
        self._grams: dict[tuple[Term, ...], Gram] = {}
        self.rows_of = {
            j: np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in problem.blocks if b.joint == j])
            for j in problem.joints
        }  # fmt: skip

    def forget(self) -> None:
        """Drop stored columns after the problem's rows were scaled anew."""
        self._columns.clear()
        self._grams.clear()

    def matrix(self, term: Term) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]:
        """Whitened columns on all rows, fixed column, sign mask, prior deviations of a term."""
        s = self.stored(term)
        if s.joint < 0:
            return s.C, s.fixed, s.positive, s.prior
        C = np.zeros((len(self.problem.y), s.C.shape[1]))
        C[self.rows_of[s.joint]] = s.C
        fixed = None
        if s.fixed is not None:
            fixed = np.zeros(len(self.problem.y))
            fixed[self.rows_of[s.joint]] = s.fixed
        return C, fixed, s.positive, s.prior

    def stored(self, term: Term) -> Stored:
        """Columns of a term, made once."""
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
            own = [x.ndim == 1 for x in (*first.linear, *([] if first.fixed is None else [first.fixed]))]
            joint = term.joint if len(self.rows_of) > 1 and term.joint in self.rows_of and all(own) else -1
            if joint >= 0:
                rows = self.rows_of[joint]
                C, fixed = C[rows], None if fixed is None else fixed[rows]
            effort = self.problem.effort if joint < 0 else self.problem.effort[self.rows_of[joint]]
            effort_rms = float(np.sqrt(np.mean(effort**2))) + 1e-12
            size = np.sqrt(np.mean(C**2, axis=0)) + 1e-12 * effort_rms
            prior = effect.deviations() if isinstance(effect, LinkGroup) else 0.5 * effort_rms / size
            stored = self._columns[term] = Stored(joint, C, fixed, positive, prior)
        return stored

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
        deviation[: p.B.shape[1]] *= self.looseness
        x, _ = _constrained(gram.G, gram.g, deviation, gram.positive, noise)
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
        Bf, yf = B[fit], y[fit]
        x, covariance = _constrained(Bf.T @ Bf, Bf.T @ yf, deviation, sign, noise)
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

    def at_floor(self, chosen: list[Term]) -> bool:
        """Is what is left over indistinguishable from the noise floor, on fitted and on held-out rows?"""
        p = self.problem
        x, B, y, _ = self.solve(chosen, self.noise_level(chosen))
        left = self.without_drift(y - B @ x, TEMPER, self.added_friction(chosen, x))
        raw = self.unwhitened(self.within_doubt(left))
        slack = FLOOR_SLACK_AFTER if chosen else FLOOR_SLACK
        for block in p.blocks:
            for mask in (block.held, ~block.held):
                if mask.any() and p.rms(raw, block, mask) > slack * p.floor[block.joint]:
                    return False
        return not self.comes_back(chosen)

    def within_doubt(self, left: np.ndarray) -> np.ndarray:
        """Leftover with the base parameters moved on held-out rows as far as the fitted rows leave them open.

        A held-out motion that is much livelier than the fitted ones asks more of a mass than those could tell. What
        the noise of the fitted rows leaves of the prior is the prior of the held-out rows.
        """
        p = self.problem
        if not p.B.shape[1] or not p.held.any():
            return left
        fitted, held = p.B[~p.held], p.B[p.held]
        open_still = fitted.T @ fitted / TEMPER + np.diag(1.0 / (p.prior * self.looseness) ** 2)
        moved = np.linalg.solve(held.T @ held / TEMPER + open_still, held.T @ left[p.held] / TEMPER)
        left = left.copy()
        left[p.held] -= held @ moved
        return left

    def quiet(self, chosen: list[Term]) -> set[int]:
        """Joints of an arm that the terms chosen bring to their noise floor, unless all of them are there."""
        p = self.problem
        if len(p.joints) == 1:
            return set()
        x, left = self.fitted(chosen, self.noise_level(chosen))
        raw = self.unwhitened(self.without_drift(left, TEMPER, self.added_friction(chosen, x)))
        loud = {
            b.joint
            for b in p.blocks
            for mask in (b.held, ~b.held)
            if mask.any() and p.rms(raw, b, mask) > QUIET * p.floor[b.joint]
        }
        return set(p.joints) - loud if loud else set()

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
        found = self.added_friction(chosen, x)
        drift = [d.estimate(raw_drifted, noise, found)[:3] for d in p.drift]
        left = self.without_drift(raw_drifted, noise, found)
        y0 = p.y
        fit, held = ~p.held, p.held

        def mean2(v: np.ndarray, mask: np.ndarray) -> float:
            return float(np.mean(v[mask] ** 2)) if mask.any() else float("nan")

        raw_left = self.unwhitened(left)
        predicted = self.unwhitened(self.within_doubt(left))
        return Solution(
            chosen, slots, thetas, covariances, x[:nb], np.sqrt(np.maximum(np.diag(covariance)[:nb], 0.0)), noise,
            (mean2(y0, fit), mean2(left, fit)), (mean2(y0, held), mean2(left, held)),
            (mean2(p.raw, fit), mean2(raw_left, fit)), (mean2(p.raw, held), mean2(raw_left, held)),
            predicted, drift, self.unwhitened(raw_drifted), scans,
        )  # fmt: skip

    def unwhitened(self, left: np.ndarray) -> np.ndarray:
        """Whitened rows back to effort units, block by block."""
        out = np.zeros_like(left)
        for block in self.problem.blocks:
            rows = (left / self.problem.weight)[block.rows]
            out[block.rows] = unwhiten(rows, self.problem.whiteners[block.joint])
        return out


def _constrained(
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
