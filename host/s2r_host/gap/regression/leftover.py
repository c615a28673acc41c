"""What a set of terms leaves over: noise, or something that is still there; and the fitted whole."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion

from s2r_host.gap.regression.friction_seen import TRUSTED
from s2r_host.gap.regression.regression import TEMPER, Regression, unwhiten
from s2r_host.gap.regression.solution import Scored, Solution, Term
from s2r_host.gap.regression.strokes import left_over, together

FLOOR_SLACK = 1.2
FLOOR_SLACK_AFTER = 1.4
# Leftover common to two runs of one motion: correlation, and power in noise floors (clean recordings stay below 0.7).
COMMON_CORRELATION, COMMON_POWER = 0.35, 0.75
LEAST_ROWS = 60
BESIDE_REST = 2  # rows
STRAINED = 4.0  # declared deviations of a recording's scale
QUIET = 1.12  # noise floors; a joint of an arm with no more than that is not searched


class Leftover(Regression):
    """Holds what is left over against the noise floor and against a second run."""

    def at_floor(self, chosen: list[Term]) -> bool:
        """Is what is left over indistinguishable from the noise floor, on fitted and on held-out rows?"""
        p = self.problem
        x, B, y, _ = self.solve(chosen, self.noise_level(chosen))
        if self._scales_strained(x):
            return False
        left = self.without_drift(y - B @ x, TEMPER, self.added_friction(chosen, x))
        raw = self.unwhitened(self.within_doubt(left))
        slack = FLOOR_SLACK_AFTER if chosen else FLOOR_SLACK
        for blocks in together(p):
            for held in (True, False):
                left_now = left_over(p, raw, blocks, held=held)
                if left_now is not None and left_now > slack:
                    return False
        return not self.comes_back(chosen)

    def _scales_strained(self, x: np.ndarray) -> bool:
        """Would the effort of a recording have to be off by far more than its side file says it may be?"""
        pairs = zip(self.problem.base, x, self.problem.prior, strict=False)
        return any(p.name == "gain" and abs(found) > STRAINED * sigma for p, found, sigma in pairs)

    def within_doubt(self, left: np.ndarray) -> np.ndarray:
        """Leftover with the base parameters moved on held-out rows as far as the fitted rows leave them open.

        A held-out motion that is much livelier than the fitted ones asks more of a mass than those could tell. What
        the noise of the fitted rows leaves of the prior is the prior of the held-out rows.
        """
        p = self.problem
        if not p.B.shape[1] or not p.held.any():
            return left
        fitted, held = p.B[~p.held], p.B[p.held]
        open_still = fitted.T @ fitted / TEMPER + np.diag(1.0 / p.prior_at(self.looseness) ** 2)
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
            a = raw[first.rows] * self.problem.trust[first.rows]
            b = unwhiten(left[again.rows] / second.weight[again.rows], second.whiteners[again.joint])
            b = b * second.trust[again.rows]
            n = min(len(a), len(b))
            trusts = self.problem.trust[first.rows][:n], second.trust[again.rows][:n]
            # What friction holds at rest comes back, too, and filters blur it.
            clear = np.minimum(*trusts) ** 2 >= TRUSTED
            moves = np.asarray(binary_erosion(clear, iterations=BESIDE_REST, border_value=1), dtype=bool)
            if moves.sum() < LEAST_ROWS:
                continue
            a, b = a[:n][moves], b[:n][moves]
            correlation = float(np.corrcoef(a, b)[0, 1])
            power = float(np.mean(a * b)) / self.problem.floor[first.joint] ** 2
            power -= self.problem.alike[first.joint]
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
        drifted = y - B @ x
        found = self.added_friction(chosen, x)
        drift = [d.estimate(drifted, noise, found)[:3] for d in p.drift]
        left = self.without_drift(drifted, noise, found)

        def mean2_held(v: np.ndarray) -> float:
            return float(np.mean(v[p.held] ** 2)) if p.held.any() else float("nan")

        return Solution(
            chosen, slots, thetas, covariances, x[:nb], np.sqrt(np.maximum(np.diag(covariance)[:nb], 0.0)), noise,
            (mean2_held(p.raw), mean2_held(self.unwhitened(left))), self.unwhitened(self.within_doubt(left)),
            drift, scans,
        )  # fmt: skip
