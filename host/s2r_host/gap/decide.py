"""From a search to a verdict: what is named, what is refused, with which probability and interval."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from s2r_host.gap.base_terms import PREFIX, BaseTerm
from s2r_host.gap.kinematics import Contradiction
from s2r_host.gap.law import LawFinding
from s2r_host.gap.naming import CEILING, MODEL_ERROR, Z90, Named, named_effect, parameter_table
from s2r_host.gap.problem import Problem
from s2r_host.gap.rejected import rejected_at_floor, rejected_list
from s2r_host.gap.search import MAX_EFFECTS, Scored, Search, Solution, Term
from s2r_host.gap.wrong_number import (
    ALIKE_GAIN,
    ALIKE_SHARE,
    LIKE_PARAMETERS,
    ONE_CAUSE,
    TIGHT,
    base_matters,
    nominal_friction_of,
    one_cause,
    tries_of,
    turned_not_shifted,
    with_number,
)

# What an effect of this name is called as a wrong number, and the value the model gives it.
AS_PARAMETER = {
    "payload": ("payload_mass", 0.0),
    "armature": ("armature", None),
    "effort_scale": ("effort_scale", 1.0),
}
FEW_JOINTS = 2  # arms weigh the numbers of all links together (complete.py)
LEFTOVER_LIMIT = 1.45
EXPLAINED_CLOSE, EXPLAINED_SLOPE, EXPLAINED_FAR = 0.6, 0.25, 0.88
EXPLAINED_GUESSED = 0.5
SLOW_S, SLOW_DOUBT = 0.011, 1.3
NO_WORSE = 1.3
SMALL_CHANGE = 0.6
DRIFT_ODDS, DRIFT_COMMON, DRIFT_LEAST, DRIFT_ERROR = 18.0, 0.7, 0.02, 0.05
OTHER_MACHINE = 0.4
FAR_RIGID, FAR_FRICTION, FAR_KINDS, FAR_SCALE = 0.08, 0.3, 4, 2.0
# What a position read behind a compliant gear looks like to the plant's equation.
BEHIND_THE_SENSOR = (
    "clock_skew", "actuator_delay", "bandwidth", "flexible_part", "backlash", "joint_elasticity", "payload",
    "armature", "presliding",
)  # fmt: skip


@dataclass
class Decision:
    """Verdict with everything behind it."""

    verdict: str
    solution: Solution
    effects: list[Named] = field(default_factory=list)
    parameters_off: list[dict] = field(default_factory=list)
    rejected: list[dict] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    leftover: float = 0.0
    explained: float = 0.0
    law: list[LawFinding] = field(default_factory=list)
    contradictions: list[Contradiction] = field(default_factory=list)


def decide(problem: Problem, search: Search, log: Callable[[str], None] = lambda _: None) -> Decision:
    """Search, then say only what the data carry."""
    decision = _from_plant(problem, search, log)
    _add_drift(problem, decision.solution, decision)
    for finding in problem.law:
        _add_law(problem, finding, decision)
    for contradiction in problem.contradictions:
        _add_contradiction(problem, contradiction, decision)
    decision.effects.sort(key=lambda e: -e.probability)
    if decision.verdict != "unknown" and (moved := _other_machine(problem, decision)):
        decision.verdict = "unknown"
        decision.reasons.append(moved)
    if decision.verdict == "unknown":
        decision.effects = []
    return decision


def _other_machine(problem: Problem, decision: Decision) -> str | None:
    """A sentence when the parameters found belong to another machine than the model's."""
    m = problem.ctx.model.model
    for body in problem.ctx.model.jointed_bodies():
        name = problem.ctx.model.body_name(body)
        shifts = [
            p["to"] - p["from"]
            for p in decision.parameters_off if p["name"].startswith("com_") and p.get("body") == name
        ]  # fmt: skip
        arm, shift = float(np.linalg.norm(m.body_ipos[body])), float(np.linalg.norm(shifts))
        if shift > OTHER_MACHINE * arm > 0:
            return (
                f"the centre of mass of '{name}' would have to move by {shift:.3g} m from {arm:.3g} m off the joint: "
                "is this recording of another machine?"
            )
    moved = {p["name"].split("_")[0]: _moved(p) for p in decision.parameters_off}
    far = [
        n for n, x in moved.items() if x > (FAR_FRICTION if n in ("damping", "frictionloss") else FAR_RIGID)
    ]
    if len(problem.ctx.model.joints) == 1 and len(far) >= FAR_KINDS:
        return f"{', '.join(far)} would all have to change by much: is this recording of another machine?"
    for e in decision.effects:
        scale = e.parameters["scale"]["value"] if e.name == "effort_scale" else 1.0
        if len(decision.effects) > 1 and not 1.0 / FAR_SCALE < scale < FAR_SCALE:
            return f"efforts {scale:.2g} times the recorded ones and more beside: is this recording of another machine?"
    return None


def _moved(p: dict) -> float:
    """Relative change of a parameter."""
    return abs(p["to"] - p["from"]) / abs(p["from"]) if p["from"] else 0.0


def _from_plant(problem: Problem, search: Search, log: Callable[[str], None]) -> Decision:
    """What the plant's equation says: effort recorded against effort needed."""
    search.looseness = TIGHT
    if search.at_floor([]):
        log("the nominal model reaches the noise floor")
        solution = search.finish([], [], [])
        return Decision("nothing_missing", solution, rejected=rejected_at_floor(problem, search))
    search.looseness = 1.0
    if search.at_floor([]):
        log("small changes of base parameters reach the noise floor")
        decision = _parameters_only(problem, search)
        if not _too_much_left(problem, search, decision):
            return decision
    solution = search.run()
    looseness = 1.0
    few = 0 < len(solution.terms) <= MAX_EFFECTS and len(problem.joints) <= FEW_JOINTS
    if few and base_matters(search, problem, solution.terms):
        number = with_number(problem, search, solution)
        if number is not None and _fits_as_well(problem, solution, number[1]):
            looseness, solution = number
            log(f"  + {solution.terms[-1].effect}, a number")
    search.looseness = looseness
    decision = _name(problem, search, solution)
    search.looseness = 1.0
    decision.leftover = leftover(problem, solution.prediction, solution)
    decision.explained = explained(problem, search, solution)
    if not solution.terms:
        if decision.leftover > LEFTOVER_LIMIT * _doubt(problem) or search.comes_back([]):
            decision.verdict = "unknown"
            decision.reasons.append("no effect of the catalogue removes the leftover")
        elif base_matters(search, problem):
            decision = _parameters_only(problem, search)
        return decision
    if _too_much_left(problem, search, decision):
        nearest = ", ".join(e.name for e in decision.effects) or "a wrong parameter"
        decision.reasons.append(
            f"the best of the catalogue ({nearest}) leaves {decision.leftover:.1f} times the noise floor and explains "
            f"{decision.explained:.0%} of the gap"
        )
        for e in decision.effects:
            decision.rejected.insert(
                0, {"name": e.name, "joint": e.joint, "holdout_gain": round(decision.explained, 4),
                    "why": f"nearest, but leaves {decision.leftover:.1f} floors unexplained"}
            )  # fmt: skip
        decision.verdict, decision.effects = "unknown", []
    return decision


def _fits_as_well(problem: Problem, before: Solution, after: Solution) -> bool:
    """Numbers held tighter must not cost what a single one gains."""
    left = leftover(problem, after.prediction, after)
    return left <= max(
        LEFTOVER_LIMIT * _doubt(problem), NO_WORSE * leftover(problem, before.prediction, before)
    )


def _too_much_left(problem: Problem, search: Search, decision: Decision) -> bool:
    """Does the best explanation leave so much that its name would be a guess?"""
    if decision.leftover <= LEFTOVER_LIMIT * _doubt(problem):
        return False
    return decision.explained < _explained_least(problem, search, decision.solution, decision.leftover)


def _doubt(problem: Problem) -> float:
    """How far the floor may be too low; what happens between the rows of a slow log differs from run to run."""
    slow = any(s.rec.dt > SLOW_S for s in problem.ctx.sessions)
    return problem.floor_doubt * (SLOW_DOUBT if slow else 1.0)


def _add_law(problem: Problem, finding: LawFinding, decision: Decision, why: str = "") -> None:
    """Name what the control law shows: a wrong gain, late stamps, or what a measured effort hides."""
    why = (
        why or f"the declared control law misses the recorded effort; this removes {finding.share:.0%} of it"
    )
    joint = problem.ctx.model.joints[finding.joint]
    if finding.name == "controller_gain":
        for which, p in finding.parameters.items():
            decision.parameters_off.append(_off(f"controller_{which}", joint, True, p["from"], p))
        if decision.verdict == "nothing_missing":
            decision.verdict = "parameter_off"
        return
    if any(e.name == finding.name and e.joint == joint for e in decision.effects):
        return
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


def _add_contradiction(problem: Problem, found: Contradiction, decision: Decision) -> None:
    """What position and speed of one joint say against each other: a transmission between them, or no name at all."""
    joint = problem.ctx.model.joints[found.joint]
    decision.reasons.append(found.words)
    if found.finding is None:
        decision.verdict = "unknown"
        decision.contradictions.append(found)
        return
    decision.effects = [e for e in decision.effects if e.joint != joint or e.name not in BEHIND_THE_SENSOR]
    decision.verdict = "physics_missing"
    _add_law(problem, found.finding, decision, found.words)


def _add_drift(problem: Problem, solution: Solution, decision: Decision) -> None:
    """Name the change of friction in held-out sessions that were not among the fitted ones."""
    for drift, (change, covariance, level) in zip(problem.drift, solution.drift, strict=True):
        share, deviation = _common_share(level, change, covariance)
        total = 0.5 * float(change @ np.linalg.solve(covariance, change))
        odds = 0.5 * (share / deviation) ** 2
        # What raises one kind of friction and lowers the other is no session's doing, but something unmodelled.
        if odds < DRIFT_ODDS or odds < DRIFT_COMMON * total or abs(share) < DRIFT_LEAST:
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


def _explained_least(problem: Problem, search: Search, solution: Solution, left: float) -> float:
    """Below this share the answer is 'unknown'.

    The share asked for rises with what is left over; it is lower when the floor is a guess or an effect is chaotic.
    """
    bar = EXPLAINED_GUESSED
    if problem.floor_source == "repeat":
        beyond = left / problem.floor_doubt - LEFTOVER_LIMIT
        bar = float(np.clip(EXPLAINED_CLOSE + EXPLAINED_SLOPE * beyond, EXPLAINED_CLOSE, EXPLAINED_FAR))
    bar = 1.0 - (1.0 - bar) / max(len(solution.terms), 1)  # several effects together imitate almost anything
    return min([bar, *(search.effects[t.effect].explained_least for t in solution.terms)])


def leftover(problem: Problem, rows: np.ndarray, solution: Solution) -> float:
    """Largest ratio of a block's leftover rms to its floor, held-out rows when there are any."""
    del solution
    worst = 0.0
    for block in problem.blocks:
        mask = block.held if block.held.any() else ~block.held
        worst = max(worst, problem.rms(rows, block, mask) / problem.floor[block.joint])
    return worst


def explained(problem: Problem, search: Search, solution: Solution) -> float:
    """Share of the gap above the floor that the solution removes on held-out rows.

    The gap is what small changes of base parameters leave over: a wrong mass is no merit of an effect.
    """
    rows = search.finish([], [], []).prediction
    before = after = 0.0
    for block in problem.blocks:
        mask = block.held if block.held.any() else ~block.held
        floor = problem.floor[block.joint] ** 2
        before += max(0.0, problem.rms(rows, block, mask) ** 2 / floor - 1.0)
        after += max(0.0, problem.rms(solution.prediction, block, mask) ** 2 / floor - 1.0)
    return 1.0 - after / before if before > 0 else 0.0


# --- names, probabilities, parameters -----------------------------------------------------------------------


def _name(problem: Problem, search: Search, solution: Solution) -> Decision:
    decision = Decision("nothing_missing", solution)
    for i, term in enumerate(solution.terms):
        slot = solution.slots[i] if i < len(solution.slots) else []
        named = named_effect(problem, search, solution, i, slot)
        if term.effect.startswith(PREFIX) or _is_parameter(problem, term, solution.theta[i], slot):
            decision.parameters_off += _off_entries(problem, search, named)
        else:
            decision.effects.append(named)
    decision.effects.sort(key=lambda e: -e.probability)
    if decision.effects:
        decision.verdict = "physics_missing"
    elif decision.parameters_off:
        decision.verdict = "parameter_off"
    decision.rejected = rejected_list(problem, search, solution)
    if solution.terms and base_matters(search, problem, solution.terms):
        known = {(p["name"], p.get("body", p.get("joint"))) for p in decision.parameters_off}
        for entry in _base_entries(problem, solution):
            if (entry["name"], entry.get("body", entry.get("joint"))) not in known:
                decision.parameters_off.append(entry)
    return decision


def _is_parameter(problem: Problem, term: Term, theta: np.ndarray, slot: list[Scored]) -> bool:
    """Is this a wrong number rather than new physics?

    So is a small addition to friction or damping the model already has, and mass, motor inertia or effort scale where
    a number of the model explains the place as well.
    """
    m = problem.ctx.model.model
    if term.effect in AS_PARAMETER:
        own = next((s.gain for s in slot if s.term.key == term.key), np.inf)
        rival = max((s.gain for s in slot if s.term.effect.startswith(PREFIX)), default=-np.inf)
        return own - rival < max(ALIKE_GAIN, ALIKE_SHARE * own)
    if term.effect == "coulomb_friction":
        nominal = float(m.dof_frictionloss[term.joint])
    elif term.effect == "viscous_friction":
        nominal = float(m.dof_damping[term.joint])
    else:
        return False
    return nominal > 0 and abs(float(theta[0])) < SMALL_CHANGE * nominal


def restate(problem: Problem, search: Search, decision: Decision) -> None:
    """Parameter tables of the named effects, after the coefficients of the solution have moved."""
    for named in decision.effects:
        if named.term in decision.solution.terms:
            i = decision.solution.terms.index(named.term)
            named.theta = decision.solution.theta[i]
            named.parameters = parameter_table(problem, search, decision.solution, i)


# --- base parameters ------------------------------------------------------------------------------------------


def _parameters_only(problem: Problem, search: Search) -> Decision:
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
    if not one and (moved := _base_entries(problem, solution)):
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
    is_number = _is_parameter(problem, named.term, solution.theta[0], slot)
    search.looseness = 1.0
    if named.name in LIKE_PARAMETERS and not is_number:
        decision.verdict, decision.effects = "physics_missing", [named]
    else:
        decision.parameters_off = _off_entries(problem, search, named)
    decision.explained = explained(problem, search, solution)
    decision.leftover = leftover(problem, solution.prediction, solution)
    return decision


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
            found.append(_off(member.name, member.place, member.on_joint, member.nominal, p))
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
        return [_off(label, place, named.name != "payload", nominal, p)]
    nominal = nominal_friction_of(problem, named.name, named.term.joint)
    shifted = p | {"value": nominal + p["value"], "interval90": [nominal + x for x in p["interval90"]]}
    label = "frictionloss" if named.name == "coulomb_friction" else "damping"
    return [_off(label, named.joint, True, nominal, shifted)]


def _off(name: str, place: str, on_joint: bool, nominal: float, p: dict) -> dict:
    return {
        "name": name, "joint" if on_joint else "body": place, "from": nominal, "to": p["value"], "unit": p["unit"],
        "interval90": p["interval90"],
    }  # fmt: skip


def _base_entries(problem: Problem, solution: Solution) -> list[dict]:
    """Base parameters whose posterior left the nominal value by more than two deviations and one per cent."""
    found = []
    for p, x, d in zip(problem.base, solution.base, solution.base_deviation, strict=True):
        if (
            p.name in ("timing", "edge")
            or abs(x) < 2.0 * d
            or abs(x) < (0.01 if p.name != "effort_offset" else 0.0)
        ):
            continue
        value = p.nominal + x * p.size
        half = Z90 * d * p.size
        found.append(_off(p.name, p.place, p.on_joint, p.nominal, {
            "value": value, "unit": p.unit, "interval90": [value - half, value + half]}))  # fmt: skip
    return found
