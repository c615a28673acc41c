"""Which effects explain the residual: greedy selection with replacement over the whole catalogue."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from s2r_host.gap.base_terms import PREFIX
from s2r_host.gap.complete import complete
from s2r_host.gap.effects.base import Effect
from s2r_host.gap.evidence import Marginal
from s2r_host.gap.problem import Problem
from s2r_host.gap.regression import Regression
from s2r_host.gap.solution import Scored, Solution, Term

MIN_GAIN = 12.0
# Evidence, its share of the first effect's, change held out.
CLEAR_GAIN, CLEAR_SHARE, NO_LOSS = 20.0, 0.05, -0.05
# Effects that are no more than one number.
NUMBERS = (
    "payload", "armature", "effort_scale", "gravity_tilt", "encoder_offset", "coulomb_friction", "viscous_friction",
)  # fmt: skip
MAX_EFFECTS = 3
CONTAINER_CHARGE = 5.0
CONTAINER_SHARE = 0.002
FURTHER_SHARE = 0.3
FURTHER_GAIN = 0.004
AHEAD, AHEAD_SHARE = 5.0, 0.1  # log odds before the next name; held-out misfit it takes
HAND_IN_HAND, HAND_IN_HAND_SHARE = (
    4,
    0.6,
)  # first effects tried in pairs; held-out misfit the second has to take


def _share(term: Term, without: dict[int, float], misfit: dict[int, float]) -> float:
    """Share of the held-out misfit a term takes: on its own joint, or on the joint where it takes most."""
    place = term.joint if term.joint in without else max(without, key=lambda j: without[j] - misfit[j])
    return 1.0 - misfit[place] / max(without[place], 1e-30)


class Search(Regression):
    """Weighs candidates on top of what is chosen, and chooses."""

    def __init__(
        self,
        problem: Problem,
        skip: frozenset[str] = frozenset(),
        log: Callable[[str], None] = lambda _: None,
    ) -> None:
        super().__init__(problem, skip)
        self.log = log
        self._shapes: dict[tuple[str, int], list[Term]] = {}
        self._scanned: dict[tuple[tuple[Term, ...], bytes], tuple[list[Scored], float]] = {}
        self.completed = 0

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
            share = _share(term, raw_without, raw)
            scored.append(Scored(term, score, score - without - without_held, share, np.zeros(0)))
        self._charge_containers(scored)
        scored.sort(key=lambda x: -x.score)
        return scored, without + without_held

    def _charge_containers(self, scored: list[Scored]) -> None:
        """An effect that contains a simpler one has to beat it by more than the model error of the simpler one."""
        gains = {s.term.key: s.gain for s in scored}
        for s in scored:
            inner = [
                gains[(n, s.term.joint)]
                for n in self.effects[s.term.effect].contains
                if (n, s.term.joint) in gains
            ]
            if inner:
                charge = max(CONTAINER_CHARGE, CONTAINER_SHARE * max(inner))
                s.score, s.gain = s.score - charge, s.gain - charge

    def predict(self, terms: list[Term], noise: float) -> tuple[float, dict[int, float]]:
        """Log likelihood of the held-out rows under coefficients fitted elsewhere, and their misfit.

        The misfit is squared, in noise floors, per joint: a newton metre is little on a shoulder and much on a wrist.
        """
        p = self.problem
        rss, left = self._held_misfit(terms, noise)
        raw = p.weight * self.unwhitened(left)
        misfit = dict.fromkeys(p.joints, 0.0)
        for b in p.blocks:
            misfit[b.joint] += float(np.sum(raw[b.rows][b.held] ** 2)) / p.floor[b.joint] ** 2
        return -0.5 * rss / noise, misfit

    def _held_misfit(self, terms: list[Term], noise: float) -> tuple[float, np.ndarray]:
        x, left = self.fitted(terms, noise)
        left = self.without_drift(left, noise, self.added_friction(terms, x))
        return float(np.sum(left[self.problem.held] ** 2)), left

    def stands_out(self, chosen: list[Term], slots: list[list[Scored]]) -> bool:
        """At the noise floor: does one more effect, no mere number, still beat changes of the base parameters clearly?

        A floor holds in the sum; a delay that five of its prior deviations in a timing error make up for does not.
        """
        scored, _ = self._scan_profiled(chosen)
        best = next((s for s in scored if not s.term.effect.startswith(PREFIX)), None)
        if best is None or best.term.effect in NUMBERS:
            return False
        return self._clear(best, slots)

    def run(self, max_effects: int = MAX_EFFECTS, look: bool = False) -> Solution:
        """Greedy selection, then replacement of each term while that helps; ``look``: once even at the floor."""
        chosen, slots = complete(self)
        self.completed = len(chosen)
        scans: list[Scored] = []
        while len(chosen) < self.completed + max_effects:
            own = slots[self.completed :]
            reached = self.at_floor(chosen)
            if reached and not (look and not chosen) and not (own and self.stands_out(chosen, own)):
                break
            scored, _ = self._scan_profiled(chosen)
            if len(chosen) == self.completed:
                scans = scored
            worth = bool(scored) and (self._clear(scored[0], own) or self._worth_it(scored[0], own))
            if not worth and scored and not own:
                worth = self._explains_what_comes_back(chosen, scored)
            if not worth:
                pair = [] if own or not scored else self._hand_in_hand(chosen, scored)
                if not pair:
                    break
                for term in pair:
                    self.log(f"  + {term.effect} on {self._joint(term)}, together")
                chosen, slots = self._replace([*chosen, *pair], [*slots, [], []])
                continue
            self.log(
                f"  + {scored[0].term.effect} on {self._joint(scored[0].term)}: gain {scored[0].gain:.0f}"
            )
            chosen.append(scored[0].term)
            slots.append(scored)
            chosen, slots = self._replace(chosen, slots)
        chosen, slots = self._prune(chosen, slots)
        if len(chosen) > self.completed > 0:
            chosen, slots = self._prune_completed(chosen, slots)
        return self.finish(self.settled(chosen), slots, scans)

    def _hand_in_hand(self, chosen: list[Term], scored: list[Scored]) -> list[Term]:
        """Two effects of which neither predicts well without the other (a catch beside friction); empty if none do.

        A joint that catches and rubs is fitted by either alone: the one asks for a pull far from the catch, the other
        for friction as strong as the catch. Both predict worse than nothing there, and both together well.
        """
        refuted = sorted((s for s in scored if s.refuted > MIN_GAIN), key=lambda s: -s.refuted)[:HAND_IN_HAND]
        best: tuple[float, list[Term]] = (0.0, [])
        for first in refuted:
            second = next(iter(self._scan_profiled([*chosen, first.term])[0]), None)
            if second is None or second.term.effect.startswith(PREFIX):
                continue
            if second.gain > MIN_GAIN and second.holdout_gain > HAND_IN_HAND_SHARE:
                best = max(best, (first.refuted + second.gain, [first.term, second.term]), key=lambda x: x[0])
        return best[1]

    def _clear(self, best: Scored, slots: list[list[Scored]]) -> bool:
        """Evidence that is no small fraction of the first effect's cannot be the error of its equation.

        Unless that effect is chaotic, which no equation follows closely, or the floor is a guess that holds what the
        equations leave out.
        """
        if self.problem.floor_source != "repeat":
            return False
        if any(self.effects[s[0].term.effect].explained_least < 1.0 for s in slots if s):
            return False
        first = max((s.gain for s in slots[0]), default=0.0) if slots else 0.0
        return best.gain > max(CLEAR_GAIN, CLEAR_SHARE * first) and best.holdout_gain > NO_LOSS

    def _explains_what_comes_back(self, chosen: list[Term], scored: list[Scored]) -> bool:
        """What comes back in a second run is there: a name then has to beat the other names, not nothing at all."""
        best = scored[0]
        second = max((s.gain for s in scored[1:]), default=0.0)
        if best.gain < max(second, 0.0) + AHEAD or best.holdout_gain < AHEAD_SHARE:
            return False
        return self.comes_back(chosen) and not self.comes_back([*chosen, best.term])

    @staticmethod
    def _worth_it(best: Scored, slots: list[list[Scored]]) -> bool:
        """A first effect needs evidence; a further one must also take a good part of what is left."""
        if not slots:
            return best.gain > MIN_GAIN and best.holdout_gain > 0.02
        first = max((s.gain for s in slots[0]), default=0.0)
        return best.gain > max(MIN_GAIN, FURTHER_GAIN * first) and best.holdout_gain > FURTHER_SHARE

    def _scan_profiled(self, chosen: list[Term]) -> tuple[list[Scored], float]:
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

    @staticmethod
    def _refuted_last(scored: list[Scored]) -> list[Scored]:
        """What predicts the held-out effort worse than nothing is no explanation, however well it fits."""
        for s in scored:
            if s.holdout_gain < NO_LOSS:
                s.refuted = max(s.gain, 0.0)
                s.score, s.gain = s.score - s.refuted, min(s.gain, 0.0)
        return sorted(scored, key=lambda s: -s.score)

    def _replace(
        self, chosen: list[Term], slots: list[list[Scored]]
    ) -> tuple[list[Term], list[list[Scored]]]:
        for _ in range(2 if len(chosen) > self.completed + 1 else 0):
            changed = False
            for i in range(self.completed, len(chosen)):
                others = [t for k, t in enumerate(chosen) if k != i]
                scored, _ = self._scan_profiled(others)
                if scored and scored[0].term != chosen[i]:
                    if scored[0].term.key != chosen[i].key:
                        self.log(f"  {chosen[i].effect} gives way to {scored[0].term.effect}")
                        changed = True
                    chosen[i] = scored[0].term
                slots[i] = scored
            if not changed:
                break
        return chosen, slots

    def _prune(self, chosen: list[Term], slots: list[list[Scored]]) -> tuple[list[Term], list[list[Scored]]]:
        """Drop a term whose loss is not noticed any more."""
        i = 0
        while len(chosen) > 1 and i < len(chosen):
            if slots[i] and slots[i][0].gain < MIN_GAIN:
                self.log(f"  - {chosen[i].effect}")
                del chosen[i], slots[i]
                i = 0
            else:
                i += 1
        return chosen, slots

    def _prune_completed(
        self, chosen: list[Term], slots: list[list[Scored]]
    ) -> tuple[list[Term], list[list[Scored]]]:
        """Drop what completed the description and is not needed beside the effects found since."""
        while True:
            noise = self.noise_level(chosen)
            gains = [self.gain_of(chosen, i, noise) for i in range(self.completed)]
            if not gains or min(gains) > MIN_GAIN:
                for i, gain in enumerate(gains):
                    change = (
                        gain - slots[i][0].gain
                    )  # rivals for the place were weighed beside the same company
                    for s in slots[i]:
                        s.gain += change
                return chosen, slots
            weakest = int(np.argmin(gains))
            self.log(f"  - {chosen[weakest].effect} on {self._joint(chosen[weakest])}")
            chosen = [t for k, t in enumerate(chosen) if k != weakest]
            slots = [s for k, s in enumerate(slots) if k != weakest]
            self.completed -= 1

    def gain_of(self, chosen: list[Term], i: int, noise: float) -> float:
        """Log evidence and prediction that the set loses without its term ``i``."""
        others, fit = [t for k, t in enumerate(chosen) if k != i], ~self.problem.held
        base = self.marginal(others, fit, noise)
        w, prior = self.weigh(base, fit, chosen[i])
        gain = w.log_evidence(noise, prior) + 0.5 * base.rss / noise
        return gain + self.predict(chosen, noise)[0] - self.predict(others, noise)[0]

    def _joint(self, term: Term) -> str:
        return "the model" if term.joint < 0 else self.problem.ctx.model.joints[term.joint]
