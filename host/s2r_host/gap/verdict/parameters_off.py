"""Values of the model that are off: which, from what to what."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.regression.base_terms import NEVER_NEGATIVE, PREFIX, BaseTerm
from s2r_host.gap.regression.friction_seen import nominal_friction_of
from s2r_host.gap.regression.nuisance import COMPARISON
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Scored, Solution
from s2r_host.gap.search.search import Search
from s2r_host.gap.search.wrong_number import (
    ALIKE_GAIN,
    ALIKE_SHARE,
    LIKE_PARAMETERS,
    ONE_CAUSE,
    TIGHT,
    base_matters,
    one_cause,
    tries_of,
    turned_not_shifted,
    with_number,
)
from s2r_host.gap.verdict.decision import Decision, explained, leftover
from s2r_host.gap.verdict.naming import Z90, Named, named_effect
from s2r_host.gap.verdict.rejected import rejected_at_floor

# What an effect of this name is called as a wrong number, and the value the model gives it.
AS_PARAMETER = {
    "payload": ("payload_mass", 0.0),
    "armature": ("armature", None),
    "effort_scale": ("effort_scale", 1.0),
}
FRICTION = ("coulomb_friction", "viscous_friction")
LEAST_OF_FIT = 0.05  # of the misfit of the fit rows
SMALL_CHANGE = 1.6  # of what the model has: its number may be off by so much


def is_parameter(problem: Problem, named: Named, slot: list[Scored]) -> bool:
    """Is this a wrong number rather than new physics?

    So is an addition to friction or damping the model already has that is not clearly large, and mass, motor inertia or
    effort scale where a number of the model explains the place as well.
    """
    term = named.term
    if term.effect in AS_PARAMETER:
        own = next((s.gain for s in slot if s.term.key == term.key), np.inf)
        rival = max((s.gain for s in slot if s.term.effect.startswith(PREFIX)), default=-np.inf)
        return own - rival < max(ALIKE_GAIN, ALIKE_SHARE * own)
    if term.effect not in FRICTION:
        return False
    nominal = nominal_friction_of(problem.ctx.model, term.effect, term.joint)
    low, high = next(iter(named.parameters.values()))["interval90"]
    least = 0.0 if low < 0.0 < high else min(abs(low), abs(high))
    return nominal > 0 and least < SMALL_CHANGE * nominal


def parameters_only(problem: Problem, search: Search) -> Decision:
    """Name the one number (or the effect that is no more than a number) that explains the gap, or list what moved.

    The numbers not named are held tight, or at the error nominal values usually have: the evidence says which.
    """
    tries = tries_of(problem, search, [])
    without = tries[0][1] + tries[0][2]
    alone_best = max(constant + alone for _, constant, alone, _ in tries)
    one = one_cause(tries, ONE_CAUSE)
    if max(alone_best, max((value for value, _, _ in one), default=-np.inf)) < without + 5.0:
        return Decision(
            "nothing_missing", search.finish([], [], []), rejected=rejected_at_floor(problem, search)
        )
    solution = search.finish([], [], [])
    if not one and (moved := base_entries(problem, solution)):
        return Decision(
            "parameter_off", solution, parameters_off=moved, rejected=rejected_at_floor(problem, search)
        )
    if not one:  # small changes of several numbers, none of them certain: the one that comes closest alone
        _, _, alone, scored = tries[0]
        if not scored or scored[0][0] < alone + 5.0:
            return Decision("nothing_missing", solution, rejected=rejected_at_floor(problem, search))
        one = [(0.0, TIGHT, [Scored(t, v, v - alone, 0.0, np.zeros(0)) for v, t in scored])]
    _, best, slot = max(one, key=lambda x: x[0])
    slot = turned_not_shifted(slot)
    search.looseness = best
    solution = search.finish([slot[0].term], [slot], [])
    named = named_effect(problem, search, solution, 0, slot)
    decision = Decision("parameter_off", solution, rejected=rejected_at_floor(problem, search))
    is_number = is_parameter(problem, named, slot)
    search.looseness = 1.0
    if named.name in (*LIKE_PARAMETERS, *FRICTION) and not is_number:
        if _of_one_part(problem, search, solution):
            bare = search.finish([], [], [])
            if _within_declared(problem, bare):
                return Decision("nothing_missing", bare, rejected=rejected_at_floor(problem, search))
            decision.verdict, decision.leftover = "unknown", leftover(problem, problem.raw, held=False)
            decision.reasons.append(
                f"what would be {named.name} in the part that was fitted is not there in the part held out"
            )
            return decision
        decision.verdict, decision.effects = "physics_missing", [named]
        if base_matters(search, problem, solution.terms):  # a load beside a tilt
            solution = _with_one_more(problem, search, decision)
    else:
        decision.parameters_off = off_entries(problem, search, named)
    decision.explained = explained(problem, search, solution)
    decision.leftover = leftover(problem, solution.unexplained)
    return decision


def _with_one_more(problem: Problem, search: Search, decision: Decision) -> Solution:
    """List what is off beside a named effect: one number where that explains as much as several that moved a little.

    Returns:
        The solution that the list belongs to.
    """
    more = next(with_number(problem, search, decision.solution), None)
    if more is not None:
        search.looseness, both = more
        own = named_effect(problem, search, both, len(both.terms) - 1, both.slots[-1])
        search.looseness = 1.0
        if own.name.startswith(PREFIX) or is_parameter(problem, own, both.slots[-1]):
            decision.solution, decision.parameters_off = both, off_entries(problem, search, own)
            return both
    decision.parameters_off = base_entries(problem, decision.solution)
    return decision.solution


def _of_one_part(problem: Problem, search: Search, solution: Solution) -> bool:
    """Does a solution explain the fit rows, but none of the held-out ones?"""
    without = search.finish([], [], []).unexplained
    shares = []
    for rows in (problem.held, ~problem.held):
        before, after = (float(np.sum(x[rows] ** 2)) for x in (without, solution.unexplained))
        shares.append(1.0 - after / max(before, 1e-30))
    return bool(problem.held.any()) and shares[0] <= 0.0 < LEAST_OF_FIT < shares[1]


def _within_declared(problem: Problem, solution: Solution) -> bool:
    """Is all that a solution leaves over within what the recordings themselves say their efforts may be off by?

    Such an error is alike all along a recording and another one in the next: it shows in one part and not in another.
    """
    names = [problem.ctx.model.joints[j] for j in problem.joints]
    told = all(s.rec.effort_sigma.get(name, 0.0) > 0.0 for s in problem.ctx.sessions for name in names)
    return told and leftover(problem, solution.unexplained) < 1.0


def off_entries(problem: Problem, search: Search, named: Named) -> list[dict]:
    """Entries of ``parameters_off`` for an explanation that is a wrong number, with what else it could be."""
    found = []
    for entry in _off_entries(problem, search, named):
        also = [
            n for n in named.could_also_be if n != entry["name"]
        ]  # a motor's inertia is a number, and an effect
        found.append(entry | ({"could_also_be": also} if also else {}))
    return found


def _off_entries(problem: Problem, search: Search, named: Named) -> list[dict]:
    effect = search.effects[named.term.effect]
    found = []
    if isinstance(effect, BaseTerm):
        for member in effect.members:
            p = named.parameters.get(member.name) or named.parameters[f"{member.name}@{member.place}"]
            moved = abs(p["value"] - member.nominal)
            if len(effect.members) > 1 and moved < 1e-3 * member.size:
                continue
            # Evidence is for the group; of its members, mass and centre trade off, which the intervals show.
            deviation = 0.5 * (p["interval90"][1] - p["interval90"][0]) / Z90
            if len(effect.members) > 3 and moved < max(0.75 * deviation, TIGHT * member.size):
                continue
            found.append(off_entry(member.name, member.place, member.on_joint, member.nominal, p))
        return found
    p = next(iter(named.parameters.values()))
    if named.name in AS_PARAMETER:
        label, nominal = AS_PARAMETER[named.name]
        if nominal is None:
            nominal = float(problem.ctx.model.model.dof_armature[named.term.joint])
            p = p | {"value": nominal + p["value"], "interval90": [nominal + x for x in p["interval90"]]}
        place = named.joint
        if named.name == "payload":
            place = problem.ctx.model.body_name(int(dict(named.term.shape)["body"]))
        return [off_entry(label, place, named.name != "payload", nominal, p)]
    nominal = nominal_friction_of(problem.ctx.model, named.name, named.term.joint)
    shifted = p | {"value": nominal + p["value"], "interval90": [nominal + x for x in p["interval90"]]}
    label = "frictionloss" if named.name == "coulomb_friction" else "damping"
    return [off_entry(label, named.joint, True, nominal, shifted)]


def off_entry(name: str, place: str, on_joint: bool, nominal: float, p: dict) -> dict:
    """One entry of ``parameters_off`` from a stated parameter."""
    return {
        "name": name, "joint" if on_joint else "body": place, "from": nominal, "to": p["value"], "unit": p["unit"],
        "interval90": p["interval90"],
    }  # fmt: skip


def base_entries(problem: Problem, solution: Solution) -> list[dict]:
    """Base parameters whose posterior left the nominal value by more than two deviations and one per cent.

    What cannot be below zero is not told as if it were, unless all of its interval is: then the explanation is wrong.
    """
    found = []
    for p, x, d in zip(problem.base, solution.base, solution.base_deviation, strict=True):
        if p.name in COMPARISON or abs(x) < 2.0 * d or abs(x) < (0.01 if p.name != "effort_offset" else 0.0):
            continue
        value = p.nominal + x * p.size
        half = Z90 * d * p.size
        low, high = value - half, value + half
        if p.name in NEVER_NEGATIVE and high >= 0.0:
            value, low = max(value, 0.0), max(low, 0.0)
        found.append(off_entry(p.name, p.place, p.on_joint, p.nominal, {
            "value": value, "unit": p.unit, "interval90": [low, high]}))  # fmt: skip
    return found
