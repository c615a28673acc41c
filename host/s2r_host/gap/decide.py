"""From a search to a verdict: what is named, what is refused, with which probability and interval."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_host.gap.base_terms import PREFIX
from s2r_host.gap.consistency import disagreement, stretched
from s2r_host.gap.decision import (
    LEFTOVER_LIMIT,
    Decision,
    doubt,
    explained,
    explained_least_of,
    leftover,
    too_much_left,
)
from s2r_host.gap.kinematics import Contradiction
from s2r_host.gap.law import LawFinding
from s2r_host.gap.naming import CEILING, MODEL_ERROR, Z90, Named, brought, named_effect, parameter_table
from s2r_host.gap.other_machine import all_numbers_elsewhere, other_machine
from s2r_host.gap.parameters_off import base_entries, is_parameter, off_entries, off_entry, parameters_only
from s2r_host.gap.problem import Problem
from s2r_host.gap.rejected import rejected_list
from s2r_host.gap.search import MAX_EFFECTS, Search
from s2r_host.gap.solution import Solution, Term
from s2r_host.gap.trust import hides, search_under_both
from s2r_host.gap.unrepeated import Wander
from s2r_host.gap.wrong_number import TIGHT, Looseness, base_matters, with_number

FEW_JOINTS = 2  # arms weigh the numbers of all links together (complete.py)
NO_WORSE = 1.3
SAME_CAUSE = 8.0  # log odds
DRIFT_ODDS, DRIFT_COMMON, DRIFT_LEAST, DRIFT_ERROR = 18.0, 0.7, 0.02, 0.05
# What a position read behind a compliant gear looks like to the plant's equation.
BEHIND_THE_SENSOR = (
    "clock_skew", "actuator_delay", "bandwidth", "flexible_part", "backlash", "joint_elasticity", "payload",
    "armature", "presliding",
)  # fmt: skip


def decide(problem: Problem, search: Search, log: Callable[[str], None] = lambda _: None) -> Decision:
    """Search, then say only what the data carry."""
    decision = _from_plant(problem, search, log)
    _add_drift(problem, search, decision)
    for finding in problem.law:
        _add_law(problem, finding, decision)
    for contradiction in problem.contradictions:
        _add_contradiction(problem, contradiction, decision)
    if decision.verdict in ("nothing_missing", "parameter_off") and problem.wanders:
        _add_wander(problem, max(problem.wanders, key=lambda w: w.size / w.effort), decision)
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
    if search.at_floor([]):
        # A load of a hundredth of the mass stays below the floor in the sum, and is certain all the same.
        log("the nominal model reaches the noise floor")
        search.looseness = 1.0
        return parameters_only(problem, search)
    search.looseness = 1.0
    numbers_do = search.at_floor([])
    if numbers_do and not search.stands_out([], []) and not hides(search):
        log("small changes of base parameters reach the noise floor")
        decision = parameters_only(problem, search)
        if not too_much_left(problem, search, decision):
            return decision
    looseness: Looseness = 1.0
    if len(problem.joints) > FEW_JOINTS:
        solution = search.run(look=numbers_do)
    else:
        looseness, solution = search_under_both(search, look=numbers_do)
        search.looseness = 1.0
    few = 0 < len(solution.terms) <= MAX_EFFECTS and len(problem.joints) <= FEW_JOINTS
    if few and base_matters(search, problem, solution.terms):
        number = with_number(problem, search, solution)
        if number is not None and _fits_as_well(problem, search, solution, number[1]):
            looseness, solution = number
            log(f"  + {solution.terms[-1].effect}, a number")
    search.looseness = looseness
    decision = _name(problem, search, solution)
    search.looseness = 1.0
    decision.leftover = leftover(problem, solution.prediction, solution)
    decision.explained = explained(problem, search, solution)
    if not solution.terms:
        if decision.leftover > LEFTOVER_LIMIT * doubt(problem) or search.comes_back([]):
            decision.verdict = "unknown"
            decision.reasons.append("no effect of the catalogue removes the leftover")
        elif base_matters(search, problem) or len(problem.joints) > 1:
            # The many numbers of an arm, all of them loose, hide the one that is off.
            decision = parameters_only(problem, search)
        return decision
    odd = disagreement(problem, search, solution)
    remains = decision.leftover > LEFTOVER_LIMIT * doubt(problem)
    if odd is None and remains and decision.effects and len(problem.joints) <= FEW_JOINTS:
        odd = stretched(problem, solution)
    if odd is not None:
        decision.reasons.append(odd)
    if odd is not None or too_much_left(problem, search, decision):
        nearest = ", ".join(e.name for e in decision.effects) or "a wrong parameter"
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
    return decision


def _fits_as_well(problem: Problem, search: Search, before: Solution, after: Solution) -> bool:
    """Numbers held tighter must not cost what a single one gains, nor turn a name into an unknown effect."""
    left, was = (leftover(problem, x.prediction, x) for x in (after, before))
    if left <= LEFTOVER_LIMIT * doubt(problem):
        return True
    named, still = (
        explained(problem, search, x) >= explained_least_of(problem, search, x, size)
        for x, size in ((before, was), (after, left))
    )
    return left <= NO_WORSE * was and (still or not named)


def _add_law(problem: Problem, finding: LawFinding, decision: Decision, why: str = "") -> None:
    """Name what the control law shows: a wrong gain, late stamps, or what a measured effort hides."""
    why = (
        why or f"the declared control law misses the recorded effort; this removes {finding.share:.0%} of it"
    )
    joint = problem.ctx.model.joints[finding.joint]
    if finding.name == "controller_gain":
        for which, p in finding.parameters.items():
            decision.parameters_off.append(off_entry(f"controller_{which}", joint, True, p["from"], p))
        if decision.verdict == "nothing_missing":
            decision.verdict = "parameter_off"
        return
    if any(e.name == finding.name and e.joint == joint for e in decision.effects):
        return
    decision.effects = [e for e in decision.effects if e.joint != joint or not _same_cause(e, finding.name)]
    weights = {finding.name: 1.0} | {
        n: float(np.exp(max(g - finding.gain, -60.0))) for n, g in finding.rivals.items()
    }
    also = [n for n, w in weights.items() if w > 0.05 and n not in (finding.name, "controller_gain")]
    decision.effects.append(
        Named(
            Term(finding.name, finding.joint, tuple(sorted(finding.shape.items()))), finding.name, joint,
            CEILING / sum(weights.values()), also,
            why, finding.parameters, np.zeros(0), {finding.name: finding.gain} | finding.rivals,
        )
    )  # fmt: skip
    decision.law.append(finding)
    if decision.verdict in ("nothing_missing", "parameter_off"):
        decision.verdict = "physics_missing"


def _same_cause(named: Named, other: str) -> bool:
    """Does the other name explain as well what this one was named for? Then late stamps are no delay beside."""
    own = named.log_odds.get(named.name, np.inf)
    return named.log_odds.get(other, -np.inf) > own - SAME_CAUSE


def _add_contradiction(problem: Problem, found: Contradiction, decision: Decision) -> None:
    """What position and speed of one joint say against each other: a transmission between them, or no name at all."""
    joint = problem.ctx.model.joints[found.joint]
    decision.reasons.append(found.words)
    if found.finding is None and _play_between(found, decision):
        return
    if found.finding is None:
        decision.verdict = "unknown"
        decision.contradictions.append(found)
        return
    decision.effects = [e for e in decision.effects if e.joint != joint or e.name not in BEHIND_THE_SENSOR]
    decision.verdict = "physics_missing"
    _add_law(problem, found.finding, decision, found.words)


def _play_between(found: Contradiction, decision: Decision) -> bool:
    """Does the plant's equation name play on this joint, wide enough for its sensors on both sides to disagree so?"""
    return decision.verdict == "physics_missing" and any(
        e.name == "backlash"
        and e.term.joint == found.joint
        and found.size < e.parameters["half_width"]["value"]
        for e in decision.effects
    )


def _add_wander(problem: Problem, found: Wander, decision: Decision) -> None:
    """What passes for noise since no second run repeats it, and is none."""
    name = problem.ctx.model.joints[found.joint]
    decision.verdict = "unknown"
    decision.reasons.append(found.words(name, problem.ctx.model.effort_unit(name)))


def _add_drift(problem: Problem, search: Search, decision: Decision) -> None:
    """Name the change of friction in held-out sessions that were not among the fitted ones.

    The change counts from the friction that the fitted sessions show, not from that of the model.
    """
    if not problem.drift:
        return
    search.looseness = 1.0
    drifts = search.finish(decision.solution.terms, [], []).drift
    for drift, (change, covariance, level) in zip(problem.drift, drifts, strict=True):
        share, deviation = _common_share(level, change, covariance)
        total = 0.5 * float(change @ np.linalg.solve(covariance, change))
        odds = 0.5 * (share / deviation) ** 2
        # What raises one kind of friction and lowers the other is no session's doing, but something unmodelled.
        if odds < DRIFT_ODDS or odds < DRIFT_COMMON * total or abs(share) < DRIFT_LEAST or share <= -1.0:
            continue
        s, j = drift.block.session, drift.block.joint
        joint = problem.ctx.model.joints[j]
        half = Z90 * float(np.hypot(deviation, MODEL_ERROR + DRIFT_ERROR * abs(share)))
        own = Z90 * float(np.sqrt(covariance[0, 0]))
        table = {
            "factor": {
                "value": 1.0 + share, "unit": "1", "interval90": [1.0 + share - half, 1.0 + share + half],
                "identifiable": True,
            },
            f"change_{s.rec.session}": {
                "value": float(change[0]), "unit": problem.ctx.model.effort_unit(joint),
                "interval90": [float(change[0]) - own, float(change[0]) + own], "identifiable": True,
            },
        }  # fmt: skip
        probability = CEILING / (1.0 + float(np.exp(-min(odds, 30.0))))
        named = Named(
            Term("session_friction", j), "session_friction", joint, probability, [],
            f"friction of session '{s.rec.session}' differs by {share:+.1%} from the fitted sessions",
            table, change,
        )  # fmt: skip
        decision.effects.append(named)
        if decision.verdict in ("nothing_missing", "parameter_off"):
            decision.verdict = "physics_missing"


def _common_share(level: np.ndarray, change: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Relative change common to all kinds of friction, and its deviation."""
    power = np.linalg.inv(covariance)
    scale = float(level @ power @ level)
    return float(level @ power @ change) / scale, scale**-0.5


# --- names, probabilities, parameters -----------------------------------------------------------------------


def _name(problem: Problem, search: Search, solution: Solution) -> Decision:
    decision = Decision("nothing_missing", solution)
    for i, term in enumerate(solution.terms):
        if len(solution.theta[i]) and not np.any(solution.theta[i]):
            continue  # its sign came out wrong: it has no size
        slot = solution.slots[i] if i < len(solution.slots) else []
        named = named_effect(problem, search, solution, i, slot)
        if term.effect.startswith(PREFIX) or is_parameter(problem, term, solution.theta[i], slot):
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


def restate(problem: Problem, search: Search, decision: Decision) -> None:
    """Parameter tables of the named effects, after the coefficients of the solution have moved."""
    for named in decision.effects:
        if named.term in decision.solution.terms:
            i = decision.solution.terms.index(named.term)
            named.theta = decision.solution.theta[i]
            named.parameters = parameter_table(problem, search, decision.solution, i)


# --- base parameters ------------------------------------------------------------------------------------------
