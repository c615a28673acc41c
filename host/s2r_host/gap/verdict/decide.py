"""From a search to a verdict: what is named, what is refused, with which probability and interval."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_host.gap.motion.model import FEW_JOINTS
from s2r_host.gap.regression.base_terms import NEVER_NEGATIVE, PREFIX
from s2r_host.gap.regression.friction_seen import nominal_friction_of
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.regression import TEMPER
from s2r_host.gap.regression.solution import Solution
from s2r_host.gap.search.break_away import break_away
from s2r_host.gap.search.bursts import bursts
from s2r_host.gap.search.consistency import disagreement, stretched
from s2r_host.gap.search.everywhere import LATE
from s2r_host.gap.search.outside import outside
from s2r_host.gap.search.search import MAX_EFFECTS, Search
from s2r_host.gap.search.trust import hides, search_under_both, worth
from s2r_host.gap.search.vibration import unheard_line, vibration
from s2r_host.gap.search.wrong_number import ALONE_SLACK, TIGHT, Looseness, base_matters, with_number
from s2r_host.gap.verdict.decision import (
    LEFTOVER_LIMIT,
    Decision,
    Lasting,
    doubt,
    explained,
    explained_by_numbers,
    explained_least_of,
    leftover,
    too_much_left,
)
from s2r_host.gap.verdict.naming import Named, brought, named_effect, parameter_table
from s2r_host.gap.verdict.other_equations import (
    add_break_away,
    add_contradiction,
    add_drift,
    add_law,
    add_wander,
)
from s2r_host.gap.verdict.other_machine import all_numbers_elsewhere, other_machine
from s2r_host.gap.verdict.parameters_off import base_entries, is_parameter, off_entries, parameters_only
from s2r_host.gap.verdict.rejected import rejected_list

NO_WORSE = 1.3
NEARLY_ALL = 0.95  # of the gap, by a number; less than that any number takes from what acts like it
FRICTION = ("coulomb_friction", "viscous_friction")
NOMINAL = {"effort_scale": 1.0, "gravity_tilt": 0.0, "encoder_offset": 0.0}


def decide(problem: Problem, search: Search, log: Callable[[str], None] = lambda _: None) -> Decision:
    """Search, then say only what the data carry."""
    decision = _from_plant(problem, search, log)
    add_drift(problem, search, decision)
    for finding in problem.law:
        add_law(problem, finding, decision)
    for contradiction in problem.contradictions:
        add_contradiction(problem, contradiction, decision)
    if decision.verdict in ("nothing_missing", "parameter_off") and problem.wanders:
        add_wander(problem, max(problem.wanders, key=lambda w: w.size / w.effort), decision)
    if decision.verdict in ("nothing_missing", "parameter_off"):
        for found in (break_away(problem, j) for j in problem.joints):
            if found is not None:
                add_break_away(problem, search, found, decision)
    decision.effects.sort(key=_rank)
    if decision.verdict != "unknown":
        moved = other_machine(problem, decision) or all_numbers_elsewhere(problem, search)
        if moved:
            decision.verdict = "unknown"
            decision.reasons.append(moved)
    if decision.verdict == "unknown":
        decision.effects = []
    return decision


def _rank(named: Named) -> tuple[float, float]:
    """Most probable first; among effects as good as certain the one with the most evidence."""
    return -round(named.probability, 4), -max(named.log_odds.values(), default=0.0)


def _from_plant(problem: Problem, search: Search, log: Callable[[str], None]) -> Decision:
    """What the plant's equation says: effort recorded against effort needed."""
    search.looseness = TIGHT
    if search.at_floor([]) and not (search.beats_numbers() or _bursts_have_a_name(problem, search)):
        # A load of a hundredth of the mass stays below the floor in the sum, and is certain all the same.
        log("the nominal model reaches the noise floor")
        search.looseness = 1.0
        return _one_number(problem, search, Decision("nothing_missing", search.finish([], [], [])))
    search.looseness = 1.0
    numbers_do = search.at_floor([])
    if numbers_do and not (search.stands_out([], []) or search.beats_numbers() or hides(search)):
        log("small changes of base parameters reach the noise floor")
        decision = parameters_only(problem, search)
        if _numbers_suffice(problem, search, decision):
            return decision
    looseness: Looseness = 1.0
    trusted = 1.0
    if len(problem.joints) > FEW_JOINTS:
        solution = search.run(look=numbers_do)
    else:
        trusted, solution = search_under_both(search, look=numbers_do)
        looseness = trusted
        search.looseness = 1.0
    few = 0 < len(solution.terms) <= MAX_EFFECTS and len(problem.joints) <= FEW_JOINTS
    if few:
        found = with_number(problem, search, solution)
        was_at = looseness, solution
        number = next((n for n in found if _fits_as_well(problem, search, was_at, n)), None)
        if number is not None:
            looseness, solution = number
            log(f"  + {solution.terms[-1].effect}, a number")
    search.looseness = looseness
    decision = _name(problem, search, solution)
    search.looseness = trusted  # the gap is what numbers leave over that move as far as they are trusted to
    decision.leftover = leftover(problem, solution.unexplained)
    decision.explained = explained(problem, search, solution)
    if solution.terms and all(search.a_number(t) for t in solution.terms):
        alone = explained_by_numbers(problem, solution)
        decision.explained = alone if alone > NEARLY_ALL else decision.explained
    search.looseness = 1.0
    if not solution.terms:
        remains = decision.leftover > LEFTOVER_LIMIT * doubt(problem) or search.comes_back([])
        if remains and problem.set_right < explained_least_of(problem, search, solution, decision.leftover):
            decision.verdict = "unknown"
            decision.reasons.append("no effect of the catalogue removes the leftover")
        elif base_matters(search, problem) or len(problem.joints) > 1:
            return _one_number(problem, search, decision)
        return decision
    odd = disagreement(problem, search, solution)
    remains = decision.leftover > LEFTOVER_LIMIT * doubt(problem)
    far = stretched(problem, solution)
    if odd is None and remains and decision.effects and len(problem.joints) <= FEW_JOINTS:
        odd = far
    late = any(e.name in LATE for e in decision.effects)  # follows a vibration part of the way
    if odd is None and (remains or late) and decision.effects:
        found = vibration(problem, search, solution)
        odd = None if found is None else _swings(problem, *found)
    if odd is None and (decision.effects or decision.parameters_off):
        odd = outside(problem, search, solution, strained=remains or far is not None)
    odd = odd or impossible(problem, decision)
    if odd is not None:
        decision.reasons.append(odd)
    if odd is not None or too_much_left(problem, search, decision):
        nearest = " and ".join(e.name for e in decision.effects) or "a wrong parameter"
        decision.reasons.append(
            f"the best of the catalogue ({nearest}) leaves {decision.leftover:.1f} times the noise floor and explains "
            f"{decision.explained:.0%} of the gap"
        )
        for e in decision.effects:
            decision.rejected.insert(
                0, {"name": e.name, "joint": e.joint, "holdout_gain": round(decision.explained, 4),
                    "why": odd or f"nearest, but leaves {decision.leftover:.1f} floors unexplained"}
            )  # fmt: skip
        decision.verdict, decision.effects = "unknown", []
        # Numbers found beside an imitation are as little worth as that is.
        decision.parameters_off = possible(decision.parameters_off) if odd is None else []
        if decision.parameters_off:
            decision.reasons.append(
                "the numbers listed as off may stand in for what has no name: do not take them over as they are"
            )
    return decision


def _one_number(problem: Problem, search: Search, decision: Decision) -> Decision:
    """The number that is off beside what reaches the noise floor without one: the nominal model, or all of them loose.

    It is not the one where it leaves, on rows that were held out, what they do not.
    """
    one = parameters_only(problem, search)
    if _numbers_suffice(problem, search, one):
        return one
    decision.rejected = one.rejected
    return decision


def _numbers_suffice(problem: Problem, search: Search, decision: Decision) -> bool:
    """Whether numbers that can be leave no more than the floor."""
    return impossible(problem, decision) is None and not too_much_left(problem, search, decision)


def possible(entries: list[dict]) -> list[dict]:
    """Wrong numbers of the model without those that cannot be: where the answer is 'unknown' they only filled in."""
    return [p for p in entries if not _below_zero(p)]


def _below_zero(entry: dict) -> bool:
    return entry["name"] in NEVER_NEGATIVE and entry["interval90"][1] < 0.0


def impossible(problem: Problem, decision: Decision) -> str | None:
    """A sentence where the explanation needs a mass, an inertia or a friction below zero, None otherwise."""
    for e in decision.effects:
        if e.name in FRICTION:
            p = next(iter(e.parameters.values()))
            most = nominal_friction_of(problem.ctx.model, e.name, e.term.joint) + p["interval90"][1]
            if most < 0.0:
                return f"it would take more than all of the {e.name} of '{e.joint}' away, which cannot be"
    for p in decision.parameters_off:
        if _below_zero(p):
            place = p.get("body") or p.get("joint")
            return f"it would take {p['name']} of '{place}' to be {p['to']:.3g} {p['unit']}, which cannot be"
    return None


def _bursts_have_a_name(problem: Problem, search: Search) -> bool:
    """Does an effect of the catalogue stand out where the floor is as high as impacts that no two runs share?

    A loose gear knocks on its flanks a little earlier or later each time: what two runs differ by is the knocks.
    """
    touched = bursts(problem, search.finish([], [], []).unexplained)
    return touched is not None and search.stands_out([], [])


def unnamed_force(problem: Problem, search: Search, decision: Decision) -> None:
    """Turn an answer without a name into 'unknown' where a force acts that a guessed noise floor holds.

    No correction by position and speed predicts a push or a vibration: they pass for noise until their times are seen.
    """
    touched = bursts(problem, search.finish([], [], []).unexplained)
    swings = unheard_line(problem) if touched is None else None
    if touched is not None:
        decision.touched = touched
        decision.reasons.append(touched.words)
    elif swings is not None:
        words = _swings(problem, *swings)
        decision.touched = Lasting.along(problem.ctx.sessions[0], swings[0], words)
        decision.reasons.append(words)
    else:
        return
    decision.verdict, decision.parameters_off = "unknown", []


def unnamed_force_beside(problem: Problem, search: Search, decision: Decision) -> bool:
    """Does something touch a joint that the names of a finer look leave over as the numbers alone do?"""
    touched = bursts(problem, search.finish([], [], []).unexplained)
    still = bursts(problem, decision.solution.unexplained)
    return touched is not None and still is not None and still.joint == touched.joint


def _swings(problem: Problem, j: int, f: float, amplitude: float) -> str:
    name = problem.ctx.model.joints[j]
    unit = problem.ctx.model.effort_unit(name)
    return (
        f"an effort of {amplitude:.3g} {unit} at {f:.2f} Hz goes on at '{name}' whatever it does: a vibration"
    )


def _fits_as_well(
    problem: Problem, search: Search, was_at: tuple[Looseness, Solution], is_at: tuple[Looseness, Solution]
) -> bool:
    """Numbers held tighter must not cost what a single one gains, nor turn a name into an unknown effect."""
    (loose, before), (tight, after) = was_at, is_at
    noise = max(min(before.noise, after.noise), TEMPER)
    if worth(search, after, tight, noise) < worth(search, before, loose, noise) - ALONE_SLACK:
        return False
    left, was = (leftover(problem, x.unexplained) for x in (after, before))
    if left <= LEFTOVER_LIMIT * doubt(problem):
        return True
    named, still = (
        explained(problem, search, x) >= explained_least_of(problem, search, x, size)
        for x, size in ((before, was), (after, left))
    )
    return left <= NO_WORSE * was and (still or not named)


def _name(problem: Problem, search: Search, solution: Solution) -> Decision:
    decision = Decision("nothing_missing", solution)
    for i, term in enumerate(solution.terms):
        if len(solution.theta[i]) and not np.any(solution.theta[i]) and search.stored(term).fixed is None:
            continue  # its sign came out wrong: it has no size
        slot = solution.slots[i] if i < len(solution.slots) else []
        named = named_effect(problem, search, solution, i, slot)
        if _of_no_size(named):
            continue
        if term.effect.startswith(PREFIX) or is_parameter(problem, named, slot):
            decision.parameters_off += off_entries(problem, search, named)
        else:
            decision.effects.append(named)
            decision.effects += brought(problem, search, solution, i, named)
    decision.effects.sort(key=lambda e: -e.probability)
    if decision.effects:
        decision.verdict = "physics_missing"
    elif decision.parameters_off:
        decision.verdict = "parameter_off"
    decision.rejected = rejected_list(problem, search, solution)
    if solution.terms and base_matters(search, problem, solution.terms):
        known = {(p["name"], p.get("body", p.get("joint"))) for p in decision.parameters_off}
        for entry in base_entries(problem, solution):
            if (entry["name"], entry.get("body", entry.get("joint"))) not in known:
                decision.parameters_off.append(entry)
    return decision


def _of_no_size(named: Named) -> bool:
    """Is a scale or an angle stated that may as well be what the model has? It stands in for what others leave over."""
    if named.name not in NOMINAL:
        return False
    nominal, tables = NOMINAL[named.name], named.parameters.values()
    return bool(tables) and all(p["interval90"][0] <= nominal <= p["interval90"][1] for p in tables)


def restate(problem: Problem, search: Search, decision: Decision) -> None:
    """Parameter tables of the named effects, after the coefficients of the solution have moved."""
    for named in decision.effects:
        if named.term in decision.solution.terms:
            i = decision.solution.terms.index(named.term)
            named.theta = decision.solution.theta[i]
            named.parameters = parameter_table(problem, search, decision.solution, i)
