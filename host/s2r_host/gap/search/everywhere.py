"""One cause on every joint: what lies between a controller and its drives, or between a sensor's clock and the log.

A bus, a cabinet or a recorder that is late is late for all joints alike. A search that adds one joint at a time would
spend its effects on three of them and call the rest unknown. So, on arms of three joints and more, each way of being
late is tried on all joints at once, and taken where most joints ask for it by the same time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from s2r_host.gap.regression.solution import Scored, Term

if TYPE_CHECKING:
    from s2r_host.gap.search.search import Search

LATE = {"actuator_delay": "delay", "bandwidth": "T", "clock_skew": "lag"}  # name -> its time, in the shape
LEAST_JOINTS = 3
MOST = 0.6  # of the joints
LEAST_GAIN = 12.0
ALIKE = 1.6  # times the median, or a part of it: the times of joints that one cause makes late


def late_everywhere(search: Search, chosen: list[Term]) -> tuple[list[Term], list[list[Scored]]]:
    """Terms of one name on most joints, on top of the chosen ones, with what else was tried; empty where none fits."""
    p = search.problem
    if len(p.joints) < LEAST_JOINTS or search.at_floor(chosen):
        return [], []
    sets = {name: terms for name in LATE if (terms := _late(search, chosen, name))}
    if not sets:
        return [], []
    noise = min(search.noise_level([*chosen, *terms]) for terms in sets.values())
    without = _score(search, chosen, noise)
    scores = {name: _score(search, [*chosen, *terms], noise) - without for name, terms in sets.items()}
    best = max(scores, key=lambda name: scores[name])
    scored, _ = search.scan(chosen, noise)
    alone = max((s.gain for s in scored), default=0.0)
    if scores[best] < alone + LEAST_GAIN * len(sets[best]):
        return [], []
    terms = sets[best]
    slots = []
    for i, term in enumerate(terms):
        gain = search.gain_of([*chosen, *terms], len(chosen) + i, noise)
        slot = [Scored(term, gain, gain, _share(search, chosen, terms, i, noise), np.zeros(0))]
        for name, others in sets.items():
            rival = next((t for t in others if t.joint == term.joint and name != best), None)
            if rival is not None:  # of the lead of one set over the other, each joint has its part
                less = gain - (scores[best] - scores[name]) / len(terms)
                slot.append(Scored(rival, less, less, slot[0].holdout_gain, np.zeros(0)))
        slots.append(slot)
    return terms, slots


def _late(search: Search, chosen: list[Term], name: str) -> list[Term]:
    """One way of being late on every joint that asks for it, where most do and agree on the time."""
    p = search.problem
    effect = search.effects.get(name)
    if effect is None:
        return []
    fit, terms = ~p.held, []
    for again in range(2):  # first each alone, then beside the others
        found = []
        for j in p.joints:
            others = [t for t in terms if t.joint != j] if again else []
            if not effect.applies(p.ctx, j) or effect.blocked(p.ctx, j):
                continue
            noise = search.noise_level([*chosen, *terms])
            base = search.marginal([*chosen, *others], fit, noise)
            best = search.best_shape((name, j), base, fit, noise, refine=True)
            if best is not None:
                found.append(best[1])
        terms = found
    noise = search.noise_level([*chosen, *terms])
    everything = [*chosen, *terms]
    gains = [search.gain_of(everything, len(chosen) + i, noise) for i in range(len(terms))]
    terms = [t for t, gain in zip(terms, gains, strict=True) if gain > LEAST_GAIN]
    times = np.array([dict(t.shape)[LATE[name]] for t in terms])
    if len(terms) < MOST * len(p.joints):
        return []
    middle = float(np.median(times))
    alike = [t for t, x in zip(terms, times, strict=True) if 1.0 / ALIKE < x / middle < ALIKE]
    return alike if len(alike) >= MOST * len(p.joints) else []


def _score(search: Search, terms: list[Term], noise: float) -> float:
    """Log evidence of the fit rows plus log prediction of the held-out rows."""
    from s2r_host.gap.search.wrong_number import evidence

    p = search.problem
    return evidence(search, p, terms, p.prior_at(search.looseness), noise) + search.predict(terms, noise)[0]


def _share(search: Search, chosen: list[Term], terms: list[Term], i: int, noise: float) -> float:
    """Share of the held-out misfit of its joint that one of the terms takes."""
    j = terms[i].joint
    _, with_it = search.predict([*chosen, *terms], noise)
    _, without = search.predict([*chosen, *(t for t in terms if t is not terms[i])], noise)
    return 1.0 - with_it[j] / max(without[j], 1e-30)
