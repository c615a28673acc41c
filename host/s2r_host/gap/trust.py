"""How far to trust the numbers of the model: read from the data, like any other unknown.

Nominal values are known to a few per cent or to one; with the wider prior a load, a spring or a second effect hides in
four numbers that move a little each, with the narrower one a number that is off passes for physics. So the catalogue is
searched under both, and the evidence of the whole explanation, prior of the numbers included, says which holds
(empirical Bayes; MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 28).
"""

from __future__ import annotations

import numpy as np

from s2r_host.gap.consistency import MAY_MOVE
from s2r_host.gap.regression import TEMPER
from s2r_host.gap.search import CLEAR_GAIN, Search
from s2r_host.gap.solution import Solution
from s2r_host.gap.wrong_number import evidence

WIDE, NARROW = 1.0, 0.3  # of the usual prior
AHEAD = 5.0  # log odds by which the narrower trust has to lead
FEW_JOINTS = 2
MOVED = 0.6  # of the wide prior's deviation: where no number moved so far, nothing hides in them


def search_under_both(search: Search, look: bool) -> tuple[float, Solution]:
    """The better of two searches and the looseness it was made at, which stays set."""
    search.looseness = WIDE
    wide = search.run(look=look)
    if not _moved(search, wide):
        return WIDE, wide
    completed = search.completed
    search.looseness = NARROW
    narrow = search.run(look=True)
    if {t.key for t in narrow.terms} != {t.key for t in wide.terms}:
        noise = max(min(wide.noise, narrow.noise), TEMPER)
        lead = worth(search, narrow, NARROW, noise) - worth(search, wide, WIDE, noise)
        if lead > AHEAD:
            search.log(f"numbers of the model held narrowly explain more: {lead:.0f} log odds")
            return NARROW, narrow
    search.looseness, search.completed = WIDE, completed
    return WIDE, wide


def hides(search: Search) -> bool:
    """Do numbers that reach the noise floor together hide an effect? Then it is clear where they are held narrowly.

    It has to come before every single number there, and to be worth more than all of them moving a little.
    """
    problem, before = search.problem, search.looseness
    if len(problem.joints) > FEW_JOINTS or not _moved(search, search.finish([], [], [])):
        return False
    search.looseness = NARROW
    scored, noise = search.scan_profiled([])
    best = scored[0] if scored else None
    found = best is not None and not search.a_number(best.term) and search.clear(best, [])
    if found:
        assert best is not None
        lead = best.gain
        for looseness, sign in ((NARROW, 1.0), (WIDE, -1.0)):
            search.looseness = looseness
            lead += sign * (
                evidence(search, problem, [], problem.prior * looseness, noise) + search.predict([], noise)[0]
            )
        found = lead > CLEAR_GAIN
    search.looseness = before
    return found


def _moved(search: Search, solution: Solution) -> bool:
    """Did a number of the model move as far as the narrower trust would not let it?"""
    p = search.problem
    far = [
        abs(x) / d for b, x, d in zip(p.base, solution.base, p.prior, strict=True) if b.name not in MAY_MOVE
    ]
    return max(far, default=0.0) > MOVED


def worth(search: Search, solution: Solution, looseness: float, noise: float) -> float:
    """Log evidence of fitted rows and log prediction of held-out ones, at one looseness of the model's numbers."""
    problem, before = search.problem, search.looseness
    search.looseness = looseness
    found = evidence(search, problem, solution.terms, problem.prior * looseness, noise)
    found += search.predict(solution.terms, noise)[0]
    for term, theta in zip(solution.terms, solution.theta, strict=True):
        effect, shape = search.effects[term.effect], dict(term.shape)
        found += effect.log_prior(problem.ctx, term.joint, shape)
        found += effect.size_prior(problem.ctx, term.joint, shape, theta)
        found -= 0.5 * len(shape) * float(np.log(max(len(search.seeds(term.key)), 2)))
    search.looseness = before
    return float(found)
