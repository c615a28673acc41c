"""Which effects explain the residual: greedy selection with replacement over the whole catalogue."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_host.gap.regression.base_terms import PREFIX
from s2r_host.gap.regression.friction_seen import nominal_friction_of
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Scored, Solution, Term
from s2r_host.gap.search.complete import complete
from s2r_host.gap.search.everywhere import LATE, late_everywhere
from s2r_host.gap.search.returned import spring_and_loop
from s2r_host.gap.search.scan import NO_LOSS, Scan

MIN_GAIN = 12.0
LEAST_SHARE = 0.02  # of the held-out misfit that a first effect takes
PREDICTS = 0.5  # the same, for what fits less well to go before what predicts nothing
# Of the evidence of the best name; of what that leaves on rows held out, where it leaves so much.
NEARLY, FRACTION, LEAVES = 0.9, 0.5, 0.05
CLEAR_GAIN, CLEAR_SHARE = 20.0, 0.05  # evidence, its share of the first effect's
# Effects that are no more than one number; friction is one where the model has some of its kind.
NUMBERS = ("payload", "armature", "effort_scale", "gravity_tilt", "encoder_offset")
FRICTION = ("coulomb_friction", "viscous_friction")
CHAOTIC_SHARE = 0.7  # the same where that effect is chaotic
LATE_SHARE = 0.1  # of the held-out misfit that a second name for something late takes
MAX_EFFECTS = 3
FURTHER_SHARE = 0.3
BEATING_SHARE = 0.5  # of the held-out misfit, taken by what goes before wrong numbers above a guessed floor
LATE_BESIDE_CHAOS = 0.6  # the same, by something late beside an effect that no equation follows closely
FURTHER_GAIN = 0.004
AHEAD, AHEAD_SHARE = 5.0, 0.1  # log odds before the next name; held-out misfit it takes
# First effects tried in pairs; held-out misfit the second has to take.
HAND_IN_HAND, HAND_IN_HAND_SHARE = 4, 0.6


class Search(Scan):
    """Chooses, adds, replaces and drops."""

    def __init__(
        self,
        problem: Problem,
        skip: frozenset[str] = frozenset(),
        log: Callable[[str], None] = lambda _: None,
    ) -> None:
        super().__init__(problem, skip)
        self.log = log
        self.completed = 0

    def run(self, max_effects: int = MAX_EFFECTS, look: bool = False) -> Solution:
        """Greedy selection, then replacement of each term while that helps; ``look``: once even at the floor."""
        chosen, slots = complete(self)
        late, late_slots = late_everywhere(self, chosen)
        if late:
            self.log(f"  + {late[0].effect} on {len(late)} joints")
        chosen, slots = [*chosen, *late], [*slots, *late_slots]
        self.completed = len(chosen)
        scans: list[Scored] = []
        while len(chosen) < self.completed + max_effects:
            own = slots[self.completed :]
            reached = self.at_floor(chosen)
            if reached and not (look and not chosen) and not (own and self.stands_out(chosen, own)):
                break
            scored = self._ranked(chosen)
            if len(chosen) == self.completed:
                scans = scored
            worth = bool(scored) and (self.clear(scored[0], own) or self._worth_it(scored[0], own))
            if not worth and scored and not own:
                worth = self._explains_what_comes_back(chosen, scored)
            if not worth:
                pair = [] if own or not scored else self._hand_in_hand(chosen, scored)
                if not pair:
                    break
                for term in pair:
                    self.log(f"  + {term.effect} on {self.joint_name(term)}, together")
                chosen, slots = self._replace([*chosen, *pair], [*slots, [], []])
                continue
            self.log(
                f"  + {scored[0].term.effect} on {self.joint_name(scored[0].term)}: gain {scored[0].gain:.0f}"
            )
            chosen.append(scored[0].term)
            slots.append(scored)
            chosen, slots = self._replace(chosen, slots)
        chosen, slots = self._prune(chosen, slots)
        if len(chosen) < self.completed + max_effects:
            chosen, slots = spring_and_loop(self, chosen, slots)
        if len(chosen) > self.completed > 0:
            chosen, slots = self._prune_completed(chosen, slots)
        return self.finish(self.settled(chosen), slots, scans)

    def _ranked(self, chosen: list[Term]) -> list[Scored]:
        """One more effect each, best first, without those ahead that fit and do not predict where a later one does.

        One that fits nearly as well and leaves a fraction of what the best leaves on rows of the same joint that were
        held out goes before it.
        """
        scored, _ = self.scan_profiled(chosen)
        first = next((i for i, s in enumerate(scored) if s.holdout_gain > LEAST_SHARE), 0)
        predicts = scored and scored[first].gain > MIN_GAIN and scored[first].holdout_gain > PREDICTS
        if predicts:
            scored = scored[first:]
        left = 1.0 - scored[0].holdout_gain if scored else 0.0
        if left < LEAVES or scored[0].gain < MIN_GAIN:
            return scored
        best = scored[0]
        nearly = [s for s in scored[1:] if s.term.joint == best.term.joint and s.gain > NEARLY * best.gain]
        better = next((s for s in nearly if 1.0 - s.holdout_gain < FRACTION * left), None)
        return scored if better is None else [better, *(s for s in scored if s.gain < better.gain)]

    def stands_out(self, chosen: list[Term], slots: list[list[Scored]]) -> bool:
        """At the noise floor: does one more effect, no mere number, still beat changes of the base parameters clearly?

        A floor holds in the sum; a delay that five of its prior deviations in a timing error make up for does not.
        """
        if chosen and self.problem.floor_source != "repeat":
            return self._beats_numbers_elsewhere(chosen)
        scored, _ = self.scan_profiled(chosen)
        best = next((s for s in scored if not s.term.effect.startswith(PREFIX)), None)
        return best is not None and not self.a_number(best.term) and self.clear(best, slots)

    def beats_numbers(self) -> bool:
        """Where the floor is a guess: does an effect explain, by itself, clearly more than any wrong number does?

        Numbers that move together always reach a guessed floor; a rail that sticks is damping below zero then.
        """
        if self.problem.floor_source == "repeat":
            return False  # ``stands_out`` asks for more than that
        return self._ahead_of_numbers([]) is not None

    def _beats_numbers_elsewhere(self, chosen: list[Term]) -> bool:
        """`beats_numbers` on a joint that nothing is named on: a floor that was guessed high there holds an effect.

        A load or a tilt acts on every joint.
        """
        if any(t.joint < 0 for t in chosen):
            return False
        best = self._ahead_of_numbers(chosen)
        return best is not None and best.term.joint not in {t.joint for t in chosen}

    def _ahead_of_numbers(self, chosen: list[Term]) -> Scored | None:
        """The best effect on top of some terms, where it explains clearly more than any wrong number does."""
        scored, _ = self.scan_profiled(chosen)
        number = max((s.gain for s in scored if self.a_number(s.term)), default=0.0)
        best = next((s for s in scored if not self.a_number(s.term)), None)
        if (
            best is None
            or best.gain <= max(CLEAR_GAIN, number + MIN_GAIN)
            or best.holdout_gain <= BEATING_SHARE
        ):
            return None
        return best

    def a_number(self, term: Term) -> bool:
        """Is the effect no more than a number of the model that is off? Friction is, where the model has some."""
        if term.effect.startswith(PREFIX):
            return True
        if term.effect in FRICTION:
            return nominal_friction_of(self.problem.ctx.model, term.effect, term.joint) > 0
        return term.effect in NUMBERS

    def _worth_it(self, best: Scored, slots: list[list[Scored]]) -> bool:
        """A first effect needs evidence; a further one must also take a good part of what is left.

        What a loose gear leaves over comes a little late: a delay beside it has to take most of that.
        """
        if not slots:
            return best.gain > MIN_GAIN and best.holdout_gain > LEAST_SHARE
        first = max((s.gain for s in slots[0]), default=0.0)
        late = best.term.effect in LATE and self._chaotic(slots)
        share = LATE_BESIDE_CHAOS if late else FURTHER_SHARE
        return best.gain > max(MIN_GAIN, FURTHER_GAIN * first) and best.holdout_gain > share

    def _chaotic(self, slots: list[list[Scored]]) -> bool:
        """Is one of the effects chosen so far such that no equation follows it closely?"""
        return any(self.effects[s[0].term.effect].explained_least < 1.0 for s in slots if s)

    def clear(self, best: Scored, slots: list[list[Scored]]) -> bool:
        """Evidence that is no small fraction of the first effect's cannot be the error of its equation.

        A chaotic one, which no equation follows closely, leaves a good part of itself over: what is named beside it has
        to explain about as much. A floor that is a guess holds what the equations leave out.
        """
        if self.problem.floor_source != "repeat":
            return False
        chaotic = self._chaotic(slots)
        first = max((s.gain for s in slots[0]), default=0.0) if slots else 0.0
        share = CHAOTIC_SHARE if chaotic else CLEAR_SHARE
        # Beside an effect, a millisecond more or less fits a little everywhere.
        predicts = LATE_SHARE if slots and best.term.effect in LATE else NO_LOSS
        return best.gain > max(CLEAR_GAIN, share * first) and best.holdout_gain > predicts

    def _explains_what_comes_back(self, chosen: list[Term], scored: list[Scored]) -> bool:
        """What comes back in a second run is there: a name then has to beat the other names, not nothing at all."""
        best = scored[0]
        second = max((s.gain for s in scored[1:]), default=0.0)
        if best.gain < max(second, 0.0) + AHEAD or best.holdout_gain < AHEAD_SHARE:
            return False
        return self.comes_back(chosen) and not self.comes_back([*chosen, best.term])

    def _hand_in_hand(self, chosen: list[Term], scored: list[Scored]) -> list[Term]:
        """Two effects of which neither predicts well without the other (a catch beside friction); empty if none do.

        A joint that catches and rubs is fitted by either alone: the one asks for a pull far from the catch, the other
        for friction as strong as the catch. Both predict worse than nothing there, and both together well.
        """
        refuted = sorted((s for s in scored if s.refuted > MIN_GAIN), key=lambda s: -s.refuted)[:HAND_IN_HAND]
        best: tuple[float, list[Term]] = (0.0, [])
        for first in refuted:
            second = next(iter(self.scan_profiled([*chosen, first.term])[0]), None)
            if second is None or second.term.effect.startswith(PREFIX):
                continue
            if second.gain > MIN_GAIN and second.holdout_gain > HAND_IN_HAND_SHARE:
                best = max(best, (first.refuted + second.gain, [first.term, second.term]), key=lambda x: x[0])
        return best[1]

    def _replace(
        self, chosen: list[Term], slots: list[list[Scored]]
    ) -> tuple[list[Term], list[list[Scored]]]:
        for _ in range(2 if len(chosen) > self.completed + 1 else 0):
            changed = False
            for i in range(self.completed, len(chosen)):
                others = [t for k, t in enumerate(chosen) if k != i]
                scored = self._ranked(others)
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
            self.log(f"  - {chosen[weakest].effect} on {self.joint_name(chosen[weakest])}")
            chosen = [t for k, t in enumerate(chosen) if k != weakest]
            slots = [s for k, s in enumerate(slots) if k != weakest]
            self.completed -= 1

    def joint_name(self, term: Term) -> str:
        """Name of a joint, or what stands for all of them."""
        return "the model" if term.joint < 0 else self.problem.ctx.model.joints[term.joint]
