"""The best shape of one candidate: seeds, refinement, and shapes moved together to the top of the evidence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from s2r_host.gap.effects.base import Effect
from s2r_host.gap.regression.evidence import Marginal
from s2r_host.gap.regression.leftover import Leftover
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Term


class Shapes(Leftover):
    """Finds widths, places, speeds and the like, by log evidence on the fit rows."""

    def __init__(self, problem: Problem, skip: frozenset[str] = frozenset()) -> None:
        super().__init__(problem, skip)
        self._shapes: dict[tuple[str, int], list[Term]] = {}

    def seeds(self, key: tuple[str, int]) -> list[Term]:
        """Terms to try first for one candidate."""
        if key not in self._shapes:
            effect = self.effects[key[0]]
            self._shapes[key] = [
                Term(*key, tuple(sorted(shape.items()))) for shape in effect.shapes(self.problem.ctx, key[1])
            ]
        return self._shapes[key]

    def best_shape(
        self, key: tuple[str, int], base: Marginal, rows: np.ndarray, noise: float, refine: bool
    ) -> tuple[float, Term] | None:
        """Best shape of one candidate by log evidence on the fit rows."""

        def weigh(term: Term) -> float:
            return self._odds(term, base, rows, noise)

        scored = [(weigh(term), term) for term in self.seeds(key)]
        scored = [x for x in scored if np.isfinite(x[0])]
        if not scored:
            return None
        best = max(scored, key=lambda x: x[0])
        if refine:
            best = self._refine(best, weigh)
        penalty = 0.5 * len(best[1].shape) * np.log(max(len(scored), 2))
        return best[0] - penalty, best[1]

    def _odds(self, term: Term, base: Marginal, rows: np.ndarray, noise: float) -> float:
        """Log evidence of a term on the rows of a mask, and what is known of its shape and size."""
        w, prior = self.weigh(base, rows, term)
        if w.rss == base.rss and not w.active.any():
            return -np.inf
        effect, shape = self.effects[term.effect], dict(term.shape)
        odds = effect.log_prior(self.problem.ctx, term.joint, shape)
        odds += effect.size_prior(self.problem.ctx, term.joint, shape, w.theta)
        return w.log_evidence(noise, prior) + odds

    def _refine(self, best: tuple[float, Term], weigh: Callable[[Term], float]) -> tuple[float, Term]:
        """Pattern search on the shape, halving the steps."""
        effect: Effect = self.effects[best[1].effect]
        steps = dict(effect.refine(self.problem.ctx, best[1].joint))
        limits = effect.bounds(self.problem.ctx, best[1].joint)
        scale = 1.0
        for _ in range(5):
            improved = False
            for key, (law, step) in steps.items():
                for direction in (1.0, -1.0):
                    shape = dict(best[1].shape)
                    if key not in shape:
                        continue
                    move = direction * scale * step
                    shape[key] = float(shape[key] * np.exp(move) if law == "log" else shape[key] + move)
                    low, high = limits.get(key, (-np.inf, np.inf))
                    shape[key] = float(np.clip(shape[key], low, high))
                    trial = Term(best[1].effect, best[1].joint, tuple(sorted(shape.items())))
                    value = weigh(trial)
                    if value > best[0] + 1e-6:
                        best, improved = (value, trial), True
                        break
            if not improved:
                scale *= 0.5
        self._seen(best[1])
        return best

    def _seen(self, term: Term) -> None:
        if term not in self._shapes.setdefault(term.key, []):
            self._shapes[term.key].append(term)

    def settled(self, chosen: list[Term]) -> list[Term]:
        """The chosen terms with their shapes moved together to the top of the evidence, one term after the other.

        Shapes pull against each other (a limit and the speed at which it vanishes): steps along one at a time end on
        the flank of a ridge. A simplex walks along it (Nelder and Mead, Computer Journal 7(4), 1965).
        """
        fit, noise = ~self.problem.held, self.noise_level(chosen)
        for i, term in enumerate(chosen):
            effect, shape = self.effects[term.effect], dict(term.shape)
            steps = effect.refine(self.problem.ctx, term.joint)
            keys = [k for k, (law, _) in steps.items() if k in shape and (law != "log" or shape[k] > 0)]
            if effect.costly or len(keys) < 2:
                continue
            base = self.marginal([t for k, t in enumerate(chosen) if k != i], fit, noise)
            limits = effect.bounds(self.problem.ctx, term.joint)

            def moved(
                x: np.ndarray,
                term: Term = term,
                keys: list[str] = keys,
                steps: dict = steps,
                limits: dict = limits,
            ) -> Term:
                new = dict(term.shape)
                for key, d in zip(keys, x, strict=True):
                    law, step = steps[key]
                    value = new[key] * np.exp(d * step) if law == "log" else new[key] + d * step
                    new[key] = float(np.clip(value, *limits.get(key, (-np.inf, np.inf))))
                return Term(term.effect, term.joint, tuple(sorted(new.items())))

            start = np.concatenate([np.zeros((1, len(keys))), 0.5 * np.eye(len(keys))])
            found = minimize(
                lambda x, moved=moved, base=base: -self._odds(moved(x), base, fit, noise),
                start[0],
                method="Nelder-Mead",
                options={"initial_simplex": start, "maxfev": 60 * len(keys), "xatol": 0.02, "fatol": 0.02},
            )
            chosen = [*chosen[:i], moved(found.x), *chosen[i + 1 :]]
        return chosen
