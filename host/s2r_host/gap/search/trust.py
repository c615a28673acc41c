"""How far to trust the numbers of the model: read from the data, like any other unknown.

Nominal values are known to a few per cent or to one; with the wider prior a load, a spring or a second effect hides in
four numbers that move a little each, with the narrower one a number that is off passes for physics. So the catalogue is
searched under both, and the evidence of the whole explanation, prior of the numbers included, says which holds
(empirical Bayes; MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 28).
"""

from __future__ import annotations

import numpy as np

from s2r_host.gap.motion.model import FEW_JOINTS
from s2r_host.gap.regression.base_terms import PREFIX
from s2r_host.gap.regression.regression import TEMPER
from s2r_host.gap.regression.solution import Scored, Solution
from s2r_host.gap.search.consistency import MAY_MOVE, stretched
from s2r_host.gap.search.search import CLEAR_GAIN, Search
from s2r_host.gap.search.wrong_number import Looseness, evidence

WIDE, NARROW = 1.0, 0.3  # of the usual prior
# Log odds before the data: the numbers of a model are rather known to one per cent than to a few.
NARROW_ODDS = 1.5
MOVED = 0.6  # of the wide prior's deviation: where no number moved so far, nothing hides in them


def search_under_both(search: Search, look: bool) -> tuple[float, Solution]:
    """The better of two searches and the looseness it was made at, which stays set.

    What the other one names in the place of a single term stays a rival there. One that holds only with a number far
    from its nominal value loses to one that does without, and is no rival.
    """
    search.looseness = WIDE
    wide = search.run(look=look)
    if not _moved(search, wide):
        return WIDE, wide
    completed = search.completed
    search.looseness = NARROW
    narrow = search.run(look=True)
    if {t.key for t in narrow.terms} != {t.key for t in wide.terms}:
        noise = max(min(wide.noise, narrow.noise), TEMPER)
        lead = worth(search, narrow, NARROW, noise) - worth(search, wide, WIDE, noise) + NARROW_ODDS
        search.log(f"numbers of the model held narrowly against widely: {lead:.0f} log odds")
        # A drive that passes next to nothing fits, beside a centre of mass metres away, better than play does.
        if stretched(search.problem, wide) is not None and stretched(search.problem, narrow) is None:
            return NARROW, narrow
        if lead > 0.0:
            _stays_rival(narrow, wide, lead)
            return NARROW, narrow
        _stays_rival(wide, narrow, -lead)
    search.looseness, search.completed = WIDE, completed
    return WIDE, wide


def _stays_rival(best: Solution, other: Solution, lead: float) -> None:
    """Where two explanations differ in one term, that of the lesser one is weighed beside that of the better one."""
    mine = [t for t in best.terms if t.key not in {o.key for o in other.terms}]
    theirs = [t for t in other.terms if t.key not in {o.key for o in best.terms}]
    if len(mine) != 1 or len(theirs) != 1 or theirs[0].effect.startswith(PREFIX):
        return
    i = best.terms.index(mine[0])
    own = next((s for s in best.slots[i] if s.term.key == mine[0].key), None) if i < len(best.slots) else None
    if own is None:
        return
    gain = own.gain - lead
    rest = [s for s in best.slots[i] if s.term.key != theirs[0].key or s.gain > gain]
    if all(s.term.key != theirs[0].key for s in rest):
        rest.append(Scored(theirs[0], own.score - lead, gain, own.holdout_gain, np.zeros(0)))
    best.slots[i] = sorted(rest, key=lambda s: -s.score)


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
                evidence(search, problem, [], problem.prior_at(looseness), noise)
                + search.predict([], noise)[0]
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


def worth(search: Search, solution: Solution, looseness: Looseness, noise: float) -> float:
    """Log evidence of fitted rows and log prediction of held-out ones, at one looseness of the model's numbers."""
    problem, before = search.problem, search.looseness
    search.looseness = looseness
    found = evidence(search, problem, solution.terms, problem.prior_at(looseness), noise)
    found += search.predict(solution.terms, noise)[0]
    for term, theta in zip(solution.terms, solution.theta, strict=True):
        effect, shape = search.effects[term.effect], dict(term.shape)
        found += effect.log_prior(problem.ctx, term.joint, shape)
        found += effect.size_prior(problem.ctx, term.joint, shape, theta)
        found -= 0.5 * len(shape) * float(np.log(max(len(search.seeds(term.key)), 2)))
    search.looseness = before
    return float(found)
