"""Setting strengths: sizes of what is hidden, built in and wrong, until each shows as strongly as it is to.

First what the model file has, built in or wrong, then each hidden effect beside what is built in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from s2r_conceal import distinct
from s2r_conceal.cases import Case, feed_forward_of_the_file, with_parameters_off
from s2r_conceal.effects.table import EFFECTS
from s2r_conceal.plant import Trace
from s2r_conceal.strength import (
    DISTINCT_ENOUGH,
    Floor,
    Measured,
    Sought,
    floors_of,
    runs,
    runs_of,
    signals,
    size_of,
    span_of,
)

ITERATIONS = 7
BUILT_IN_FLOORS = 6.0  # what is built in is to matter, so that a tool has to read it
REDRAWN = ("single", "unknown", "pairs", "triples", "masked")  # groups whose strengths have to come out
SIZE_OFFSETS = {"reduction": 0.11, "factor": -1.0}  # sizes whose "nothing" is not at zero


def usable(case: Case, measured: Measured) -> bool:
    """Whether the wanted strengths came out, and whether anyone could tell them from wrong parameters."""
    if case.group not in REDRAWN:
        return True
    for k, target in enumerate(case.targets):
        strength, distinct = measured.strength[k], measured.distinct[k]
        low_enough = strength < 1.5 * target or distinct < 2.0 * DISTINCT_ENOUGH
        if not np.isfinite(strength) or strength < 0.75 * target or not low_enough:
            return False
        if target >= 3.0 and distinct < 1.0:
            return False
    return True


def calibrate(cases: Sequence[Case]) -> list[Measured]:
    """Set the size of every effect (and of every wrong parameter) in place and say what came out."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        floors = floors_of(cases)
        measured = [Measured(floor) for floor in floors]
        _size_the_files(cases, floors, measured)
        for case in cases:
            feed_forward_of_the_file(case)
        spans = [span_of(case) for case in cases]
        without = runs(cases, [case.in_model for case in cases], spans)
        for k in range(max((len(case.effects) for case in cases), default=0)):
            chosen = [i for i, case in enumerate(cases) if len(case.effects) > k]
            sought = [
                Sought(c, c.effects, k, c.targets[k], c.in_model, spans[i], floors[i], without[i])
                for i in chosen
                for c in (cases[i],)
            ]
            results = [measured[i] for i in chosen]
            _search(sought)
            distinct.measure(sought, results)
            lifted = [(s, m) for s, m in zip(sought, results, strict=True) if _lift(s, m.distinct[k])]
            distinct.measure([s for s, _ in lifted], [m for _, m in lifted])
    return measured


def _size_the_files(cases: Sequence[Case], floors: Sequence[Floor], measured: Sequence[Measured]) -> None:
    """Size what is built into the model files and what is wrong in them, against the bare machines.

    A motion that is to show nothing would make what is built in huge: there it stays in the middle of its range.
    """
    sized = [i for i, c in enumerate(cases) if c.parameters_off or (c.in_model and c.group != "insufficient")]
    chosen = [cases[i] for i in sized]
    bare = runs(chosen, [()] * len(sized), ["fit"] * len(sized))
    _search(
        [
            Sought(case, case.in_model, 0, BUILT_IN_FLOORS, (), "fit", floors[i], without)
            for i, case, without in zip(sized, chosen, bare, strict=True)
            if case.in_model
        ]
    )
    off = [(i, without) for i, without in zip(sized, bare, strict=True) if cases[i].parameters_off]
    _search_parameters(
        [cases[i] for i, _ in off],
        [floors[i] for i, _ in off],
        [w for _, w in off],
        [measured[i] for i, _ in off],
    )


def _search(sought: Sequence[Sought]) -> None:
    """Secant search of log strength over log size, all cases at once; the best size seen is kept."""
    searches = [(s, _Secant(s)) for s in sought]
    for _ in range(ITERATIONS):
        active = [(s, search) for s, search in searches if not search.done]
        trials = [s.of_size(search.size) for s, search in active]
        for (s, search), trace in zip(active, runs_of([s for s, _ in active], trials), strict=True):
            difference = signals(s.case, trace, s.floor) - signals(s.case, s.without, s.floor)
            search.tell(size_of(difference))
    for s, search in searches:
        s.effects[s.k] = s.of_size(search.best)


class _Secant:
    """One-dimensional search on a monotone but unknown curve, inside plausible limits."""

    def __init__(self, sought: Sought) -> None:
        active = sought.active
        effect = EFFECTS[active.name]
        self._low, self._high = effect.sizes(sought.scale, active.values)
        self._shift = SIZE_OFFSETS.get(effect.size, 0.0)
        self._target = np.log(sought.target)
        self._x = np.log(active.values[effect.size] + self._shift)
        self._bounds = (np.log(self._low + self._shift), np.log(self._high + self._shift))
        self._under, self._over = self._bounds
        self._seen: list[tuple[float, float]] = []
        self.best, self._miss, self.done = active.values[effect.size], np.inf, False

    @property
    def size(self) -> float:
        """The next size to try."""
        return float(np.exp(self._x) - self._shift)

    def tell(self, strength: float) -> None:
        """Strength measured at ``size``; moves on to the next size."""
        y = np.log(max(strength, 1e-6)) if np.isfinite(strength) else 12.0
        self._seen.append((self._x, y))
        miss = abs(y - self._target)
        if miss < self._miss:
            self._miss, self.best = miss, self.size
        self.done = miss < 0.07
        if y < self._target:
            self._under = max(self._under, self._x)
        else:
            self._over = min(self._over, self._x)
        self._x = self._next(y)

    def _next(self, y: float) -> float:
        slope = 1.0
        if len(self._seen) > 1:
            (x0, y0), (x1, y1) = self._seen[-2:]
            slope = (y1 - y0) / (x1 - x0) if abs(x1 - x0) > 1e-9 else 1.0
        step = (self._target - y) / np.clip(slope, 0.25, 4.0)
        x = self._x + float(np.clip(step, -3.0, 3.0))
        if not self._under < x < self._over and self._under < self._over:
            x = 0.5 * (self._under + self._over)
        return float(np.clip(x, *self._bounds))


def _lift(sought: Sought, distinct: float) -> bool:
    """Enlarge an effect that parameter changes nearly explain, where the plausible range allows it."""
    if sought.target < 3.0 or not 1e-3 < distinct < DISTINCT_ENOUGH:
        return False
    active, effect = sought.active, EFFECTS[sought.active.name]
    _, high = effect.sizes(sought.scale, active.values)
    shift = SIZE_OFFSETS.get(effect.size, 0.0)
    size = (active.values[effect.size] + shift) * 1.15 * DISTINCT_ENOUGH / distinct - shift
    sought.effects[sought.k] = sought.of_size(min(size, high))
    return True


# -- a wrong value in the model file -------------------------------------------------------------------


def _search_parameters(
    cases: Sequence[Case], floors: Sequence[Floor], without: Sequence[Trace], measured: Sequence[Measured]
) -> None:
    """Scale ``relative`` of every wrong parameter until the model's prediction misses by the target."""
    for left in (4, 3, 2, 1, 0):  # values to try after this one; the last run says what the last one does
        trial = [
            replace(case, machine=machine, controller=controller)
            for case in cases
            for machine, controller in (with_parameters_off(case),)
        ]
        traces = runs(trial, [()] * len(trial), ["fit"] * len(trial))
        for case, floor, base, m, trace in zip(cases, floors, without, measured, traces, strict=True):
            entry = case.parameters_off[0]
            difference = signals(case, trace, floor) - signals(case, base, floor)
            m.off = [strength := max(size_of(difference), 1e-9)]
            too_small = float(entry["target"]) / strength
            if left and abs(np.log(too_small)) > 0.07:
                wanted = float(entry["relative"]) * np.clip(too_small, 0.2, 5.0)
                entry["relative"] = float(np.clip(wanted, -0.6, 1.5))
