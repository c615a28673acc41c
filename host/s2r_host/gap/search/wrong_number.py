"""Wrong numbers: what a value of the model that is off explains, alone or beside effects.

Every base parameter, and every effect that is no more than a number (a load, a motor's inertia, a scale, a turned
zero), is weighed with the other numbers held tight, at the error nominal values usually have, or loose.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from s2r_host.gap.regression.base_terms import PREFIX, BaseTerm
from s2r_host.gap.regression.evidence import Marginal
from s2r_host.gap.regression.friction_seen import nominal_friction_of
from s2r_host.gap.regression.nuisance import COMPARISON
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.regression import TEMPER
from s2r_host.gap.regression.solution import Scored, Solution, Term
from s2r_host.gap.search.search import Search

TIGHT = 0.05
LIKE_PARAMETERS = ("payload", "armature", "effort_scale", "gravity_tilt", "encoder_offset")
# Log odds, and share of them, within which a wrong number explains a place as well as an effect.
ALIKE_GAIN, ALIKE_SHARE = 12.0, 0.03
LOOSENESS = (TIGHT, 0.3, 1.0)
WEIGHED = 8  # single numbers, best by the rows fitted, that are weighed by those held out as well
ONE_CAUSE, ONE_CAUSE_MORE, ALONE_SLACK = 4.0, 12.0, 6.0  # log odds


def evidence(search: Search, problem: Problem, terms: list[Term], prior: np.ndarray, noise: float) -> float:
    """Log evidence of the fit rows under a prior for the base parameters."""
    fit = ~problem.held
    y, parts = problem.y[fit], [problem.B[fit]]
    deviations = [prior]
    for term in terms:
        C, fixed, _, deviation = search.matrix(term)
        parts.append(C[fit])
        deviations.append(deviation)
        if fixed is not None:
            y = y - fixed[fit]
    B, d = np.concatenate(parts, axis=1), np.concatenate(deviations)
    m = Marginal(y, B, d, noise)
    _, logdet = np.linalg.slogdet(B.T @ B / noise + np.diag(1.0 / d**2))
    return -0.5 * m.rss / noise - 0.5 * logdet - float(np.sum(np.log(d)))


def base_matters(search: Search, problem: Problem, terms: list[Term] | None = None) -> bool:
    """Do small changes of base parameters (offsets and what is of the comparison alone apart) pay for themselves?"""
    if not problem.base:
        return False
    free = np.array([p.name not in (*COMPARISON, "effort_offset") for p in problem.base])
    if not free.any():
        return False
    tight = np.where(free, problem.prior * TIGHT, problem.prior)
    noise = search.noise_level(terms or [])
    return (
        evidence(search, problem, terms or [], problem.prior, noise)
        > evidence(search, problem, terms or [], tight, noise) + 5.0
    )


Looseness = float | np.ndarray
Try = tuple[
    Looseness, float, float, list[tuple[float, Term]]
]  # looseness, its evidence, without a term, terms


def places_held(problem: Problem) -> np.ndarray:
    """Looseness of each base parameter when sizes may err and places may not, shape (parameters,).

    A centre of mass that errs in each coordinate on its own can turn about the joint, and then stands for every
    turned zero; a size cannot.
    """
    return np.array([TIGHT if p.name.startswith("com_") else 1.0 for p in problem.base])


def tries_of(problem: Problem, search: Search, terms: list[Term]) -> list[Try]:
    """Wrong numbers on top of some terms, the other numbers held at each looseness, all at one noise level."""
    found: list[Try] = []
    trusts = (*LOOSENESS, places_held(problem))
    noise = TEMPER
    if terms:
        noise = min(_noise_at(search, terms, looseness) for looseness in trusts)
    for looseness in trusts:
        search.looseness = looseness
        found.append((looseness, *_weigh_numbers(problem, search, terms, noise)))
    search.looseness = 1.0
    return found


def _noise_at(search: Search, terms: list[Term], looseness: Looseness) -> float:
    search.looseness = looseness
    return search.noise_level(terms)


def one_cause(
    tries: list[Try], least: float, lead: float = -ALONE_SLACK
) -> list[tuple[float, Looseness, list[Scored]]]:
    """Single wrong numbers that pay: evidence, looseness, everything weighed for the place.

    One cause goes before several numbers that moved a little each, as long as it is not much the worse explanation;
    ``lead`` are the log odds it has to be ahead of them.
    """
    alone_best = max(constant + alone for _, constant, alone, _ in tries)
    return [
        (scored[0][0] + constant, looseness, [Scored(t, v, v - alone, 0.0, np.zeros(0)) for v, t in scored])
        for looseness, constant, alone, scored in tries
        if scored and scored[0][0] > alone + least and scored[0][0] + constant > alone_best + lead
    ]


def with_number(problem: Problem, search: Search, solution: Solution) -> Iterator[tuple[Looseness, Solution]]:
    """Solutions with one wrong number more that stands out, and the looseness each was found at, best first.

    Where no number of the machine pays by moving, what is left was taken by the offset of the effort or by timing. They
    are no news, so that one number then has to explain clearly more than they do. Nor is it asked for where the
    floor is a guess, which holds what the equation of the effect beside it leaves out.
    """
    matters = base_matters(search, problem, solution.terms)
    if not matters and problem.floor_source != "repeat":
        return
    lead = -ALONE_SLACK if matters else ONE_CAUSE
    one = one_cause(tries_of(problem, search, solution.terms), ONE_CAUSE_MORE, lead)
    for _, looseness, slot in sorted(one, key=lambda x: -x[0]):
        turned = turned_not_shifted(slot)
        search.looseness = looseness
        uneven = one_sided(problem, search, solution, turned[0].term)
        more = uneven or search.finish(
            [*solution.terms, turned[0].term], [*solution.slots, turned], solution.scans
        )
        search.looseness = 1.0
        yield looseness, more


def one_sided(problem: Problem, search: Search, solution: Solution, number: Term) -> Solution | None:
    """Dry friction and a zero of the effort that is off are friction that differs by direction; None otherwise."""
    for i, term in enumerate(solution.terms):
        name = problem.ctx.model.joints[term.joint]
        if term.effect != "coulomb_friction" or number.effect != f"{PREFIX}effort@{name}":
            continue
        key = ("asymmetric_friction", term.joint)
        if key[0] not in search.effects or search.effects[key[0]].blocked(problem.ctx, term.joint):
            return None
        uneven = Term(*key, (("dry", 1.0), ("viscous", 0.0)))
        slots = [list(s) for s in solution.slots]
        own = slots[i][0].gain if slots[i] else 0.0
        slots[i] = [
            Scored(uneven, own, own, slots[i][0].holdout_gain if slots[i] else 0.0, np.zeros(0)),
            *slots[i],
        ]
        return search.finish(
            [uneven if k == i else t for k, t in enumerate(solution.terms)], slots, solution.scans
        )
    return None


def _weigh_numbers(
    problem: Problem, search: Search, terms: list[Term], noise: float
) -> tuple[float, float, list[tuple[float, Term]]]:
    """Everything that is no more than a wrong number, on top of ``terms``, best first, at the looseness that is set.

    Without terms, above a floor that was measured, rows held out count as well as those fitted: numbers that all move a
    little fit better than one that is off, and predict worse where what they follow is the friction of one recording.
    Beside terms or above a guess they do not: what an equation leaves over there would be given to a number.

    Returns:
        Log evidence of that looseness itself, log likelihood without any term, and terms with their log evidence.
    """
    fit = ~problem.held
    base = search.marginal(terms, fit, noise)
    taken = {t.key for t in terms}
    scored: list[tuple[float, Term]] = []
    for name, effect in search.effects.items():
        friction = name in ("coulomb_friction", "viscous_friction")
        if not isinstance(effect, BaseTerm) and not friction and name not in LIKE_PARAMETERS:
            continue
        for j in problem.joints if effect.scope == "joint" else [-1]:
            if (name, j) in taken or not effect.applies(problem.ctx, j):
                continue
            if friction and nominal_friction_of(problem.ctx.model, name, j) <= 0:
                continue
            found = search.best_shape((name, j), base, fit, noise, refine=name in LIKE_PARAMETERS)
            if found is not None:
                scored.append(found)
    scored.sort(key=lambda x: -x[0])
    alone = -0.5 * base.rss / noise
    if not terms and problem.floor_source == "repeat":
        scored = [(v + search.predict([t], noise)[0], t) for v, t in scored[:WEIGHED]]
        scored.sort(key=lambda x: -x[0])
        alone += search.predict([], noise)[0]
    B, d = problem.B[fit], problem.prior_at(search.looseness)
    _, logdet = np.linalg.slogdet(B.T @ B / noise + np.diag(d**-2.0)) if len(d) else (1.0, 0.0)
    return -0.5 * logdet - float(np.sum(np.log(d))), alone, scored


def turned_not_shifted(slot: list[Scored]) -> list[Scored]:
    """The slot without centres of mass where a turned zero (encoder or base) explains as much as the best of them.

    A centre of mass that is off by just a turn about the joint, at the same distance, would be a coincidence. What
    explains more than that turn, as a friction that is off, stays before it.
    """
    if not slot[0].term.effect.startswith(f"{PREFIX}com"):
        return slot
    turned = [s for s in slot if s.term.effect in ("encoder_offset", "gravity_tilt")]
    least = max(ONE_CAUSE, slot[0].gain - max(ALIKE_GAIN, ALIKE_SHARE * slot[0].gain))
    if not turned or turned[0].gain < least:  # a name needs evidence of its own
        return slot
    return [s for s in slot if not s.term.effect.startswith(f"{PREFIX}com")]
