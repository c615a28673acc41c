"""Every candidate of the catalogue weighed on top of what is chosen."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Scored, Term
from s2r_host.gap.search.shapes import Shapes

NO_LOSS = -0.05  # change of the held-out misfit that still counts as none
CONTAINER_CHARGE = 5.0
CONTAINER_SHARE, CONTAINER_CHAOTIC = 0.002, 0.05


def share_taken(term: Term, without: dict[int, float], misfit: dict[int, float]) -> float:
    """Share of the held-out misfit a term takes: on its own joint, or on the joint where it takes most."""
    place = term.joint if term.joint in without else max(without, key=lambda j: without[j] - misfit[j])
    return 1.0 - misfit[place] / max(without[place], 1e-30)


class Scan(Shapes):
    """Weighs by log evidence on the fit rows plus log prediction of the held-out ones."""

    def __init__(self, problem: Problem, skip: frozenset[str] = frozenset()) -> None:
        super().__init__(problem, skip)
        self._scanned: dict[tuple[tuple[Term, ...], bytes], tuple[list[Scored], float]] = {}

    def forget(self) -> None:
        """Drop what was stored after the problem's rows were scaled anew."""
        super().forget()
        self._scanned.clear()

    def candidates(self) -> list[tuple[str, int]]:
        """Every (effect, joint) that can act here."""
        out = []
        for name, effect in self.effects.items():
            joints = [-1] if effect.scope == "model" else self.problem.joints
            out += [
                (name, j)
                for j in joints
                if effect.applies(self.problem.ctx, j) and not effect.blocked(self.problem.ctx, j)
            ]
        return out

    def scan_profiled(self, chosen: list[Term]) -> tuple[list[Scored], float]:
        """Scan twice: the noise level is that of the best explanation, not of the gap. Kept for the same set."""
        key = (tuple(chosen), np.asarray(self.looseness, dtype=float).tobytes())
        if key not in self._scanned:
            self._scanned[key] = self._scan_twice(chosen)
        return self._scanned[key]

    def _scan_twice(self, chosen: list[Term]) -> tuple[list[Scored], float]:
        noise = self.noise_level(chosen)
        scored, _ = self.scan(chosen, noise)
        if scored:
            tighter = min(self.noise_level([*chosen, s.term]) for s in scored[:5])
            if tighter < 0.8 * noise:
                noise = tighter
                scored, _ = self.scan(chosen, noise)
        return self._refuted_last(scored), noise

    def scan(self, chosen: list[Term], noise: float) -> tuple[list[Scored], float]:
        """Weigh every candidate on top of the chosen terms; also the score without any."""
        p = self.problem
        fit = ~p.held
        base = self.marginal(chosen, fit, noise)
        without = -0.5 * base.rss / noise
        found: list[tuple[float, Term]] = []
        quiet = self.quiet(chosen)
        for key in self.candidates():
            if key in [t.key for t in chosen] or key[1] in quiet:
                continue
            best = self.best_shape(key, base, fit, noise, refine=False)
            if best is not None:
                found.append(best)
        found.sort(key=lambda x: -x[0])
        top = found[0][0] if found else 0.0
        polished = []
        for i, (value, term) in enumerate(found):
            hopeful = value > without or not self.effects[term.effect].costly
            if hopeful and (i < 6 or value > top - 30.0):
                again = self.best_shape(term.key, base, fit, noise, refine=True)
                polished.append(again if again is not None else (value, term))
            else:
                polished.append((value, term))
        without_held, raw_without = self.predict(chosen, noise)
        scored = []
        for value, term in polished:
            held, raw = self.predict([*chosen, term], noise)
            score = value + held
            share = share_taken(term, raw_without, raw)
            scored.append(Scored(term, score, score - without - without_held, share, np.zeros(0)))
        self._charge_containers(scored, chosen)
        scored.sort(key=lambda x: -x.score)
        return scored, without + without_held

    def _charge_containers(self, scored: list[Scored], chosen: list[Term]) -> None:
        """An effect that contains a simpler one has to beat it by more than the model error of the simpler one.

        Beside a chaotic effect the richer one has more of that effect's leftover to fit.
        """
        gains = {s.term.key: s.gain for s in scored}
        chaotic = any(self.effects[t.effect].explained_least < 1.0 for t in chosen)
        share = CONTAINER_CHAOTIC if chaotic else CONTAINER_SHARE
        for s in scored:
            inner = [
                gains[(n, s.term.joint)]
                for n in self.effects[s.term.effect].contains
                if (n, s.term.joint) in gains
            ]
            if inner:
                charge = max(CONTAINER_CHARGE, share * max(inner))
                s.score, s.gain = s.score - charge, s.gain - charge

    @staticmethod
    def _refuted_last(scored: list[Scored]) -> list[Scored]:
        """What predicts the held-out effort worse than nothing is no explanation, however well it fits."""
        for s in scored:
            if s.holdout_gain < NO_LOSS:
                s.refuted = max(s.gain, 0.0)
                s.score, s.gain = s.score - s.refuted, min(s.gain, 0.0)
        return sorted(scored, key=lambda s: -s.score)

    def predict(self, terms: list[Term], noise: float) -> tuple[float, dict[int, float]]:
        """Log likelihood of the held-out rows under coefficients fitted elsewhere, and their misfit.

        The misfit is squared, in noise floors, per joint: a newton metre is little on a shoulder and much on a wrist.
        """
        p = self.problem
        rss, left = self._held_misfit(terms, noise)
        raw = p.trust * self.unwhitened(left)
        misfit = dict.fromkeys(p.joints, 0.0)
        for b in p.blocks:
            misfit[b.joint] += float(np.sum(raw[b.rows][b.held] ** 2)) / p.floor[b.joint] ** 2
        return -0.5 * rss / noise, misfit

    def _held_misfit(self, terms: list[Term], noise: float) -> tuple[float, np.ndarray]:
        x, left = self.fitted(terms, noise)
        left = self.without_drift(left, noise, self.added_friction(terms, x))
        return float(np.sum(left[self.problem.held] ** 2)), left

    def gain_of(self, chosen: list[Term], i: int, noise: float) -> float:
        """Log evidence and prediction that the set loses without its term ``i``."""
        others, fit = [t for k, t in enumerate(chosen) if k != i], ~self.problem.held
        base = self.marginal(others, fit, noise)
        w, prior = self.weigh(base, fit, chosen[i])
        gain = w.log_evidence(noise, prior) + 0.5 * base.rss / noise
        return gain + self.predict(chosen, noise)[0] - self.predict(others, noise)[0]
