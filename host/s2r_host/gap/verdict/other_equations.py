"""What other equations than the plant's say: control law, two sensors of a joint, starts, second runs, sessions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_host.gap.motion.kinematics import Contradiction, table_entry
from s2r_host.gap.motion.law import LawFinding
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Term
from s2r_host.gap.regression.unrepeated import Wander
from s2r_host.gap.search.break_away import BreakAway
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.decision import Decision, Lasting
from s2r_host.gap.verdict.naming import CEILING, MODEL_ERROR, SET_LEAST, Z90, Named, cooling
from s2r_host.gap.verdict.parameters_off import off_entry

SAME_CAUSE = 8.0  # log odds
BREAK_AWAY_ERROR = 0.2  # of the excess: peaks of an effort are blunted by filters and raised by noise
DRIFT_ODDS, DRIFT_COMMON, DRIFT_LEAST, DRIFT_ERROR = 18.0, 0.7, 0.02, 0.05
# What is left of a compliant gear in the plant's equation of the link alone (behind_gear.py).
BEHIND_THE_SENSOR = ("flexible_part", "backlash", "joint_elasticity")


def add_law(problem: Problem, finding: LawFinding, decision: Decision, why: str = "") -> None:
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
    if (
        finding.name == "clock_skew"
    ):  # set right before the plant's equation was asked: what it adds to it is a rest
        decision.effects = [e for e in decision.effects if (e.name, e.joint) != (finding.name, joint)]
    if any(e.name == finding.name and e.joint == joint for e in decision.effects):
        return
    decision.effects = [e for e in decision.effects if e.joint != joint or not _same_cause(e, finding.name)]
    weights = {finding.name: 1.0} | {
        n: float(np.exp(max((g - finding.gain) / cooling(finding.gain, finding.name, n), -60.0)))
        for n, g in finding.rivals.items()
    }
    likely = sorted((n for n in finding.rivals if n != "controller_gain"), key=lambda n: -weights[n])
    also = [n for n in likely if weights[n] > SET_LEAST * sum(weights.values())][:1]
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


def add_contradiction(problem: Problem, found: Contradiction, decision: Decision) -> None:
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
    add_law(problem, found.finding, decision, found.words)


def _play_between(found: Contradiction, decision: Decision) -> bool:
    """Does the plant's equation name play on this joint, wide enough for its sensors on both sides to disagree so?"""
    return decision.verdict == "physics_missing" and any(
        e.name == "backlash"
        and e.term.joint == found.joint
        and found.size < e.parameters["half_width"]["value"]
        for e in decision.effects
    )


def add_wander(problem: Problem, found: Wander, decision: Decision) -> None:
    """What passes for noise since no second run repeats it, and is none."""
    name = problem.ctx.model.joints[found.joint]
    words = found.words(name, problem.ctx.model.effort_unit(name))
    decision.verdict, decision.touched = "unknown", Lasting.along(problem.ctx.sessions[0], found.joint, words)
    decision.reasons.append(words)


def add_break_away(problem: Problem, search: Search, found: BreakAway, decision: Decision) -> None:
    """Name friction at rest above that in motion, where it is gone before a regression on the speed can see it."""
    model = problem.ctx.model
    joint, solution = model.joints[found.joint], decision.solution
    if "stribeck" not in search.effects:
        decision.verdict, decision.touched, decision.parameters_off = "unknown", found, []
        decision.reasons.append(found.words)
        return
    half = Z90 * float(np.hypot(found.deviation, BREAK_AWAY_ERROR * found.excess))
    bound = {"interval90": [0.0, found.speed], "identifiable": False}
    table = {
        "static_excess": table_entry(found.excess, half, model.effort_unit(joint)),
        "speed": table_entry(found.speed, 0.0, f"{model.unit(joint)}/s") | bound,
    }
    term = Term("stribeck", found.joint, (("vs", found.speed),))
    # Where the model has no friction, the flat part is a coefficient of its own.
    size = 1 if model.model.dof_frictionloss[found.joint] > 0.0 else 2
    theta, spread = np.zeros(size), np.zeros((size, size))
    theta[0], spread[0, 0] = found.excess, found.deviation**2
    decision.solution = replace(
        solution, terms=[*solution.terms, term], slots=[*solution.slots, []],
        theta=[*solution.theta, theta], covariance=[*solution.covariance, spread],
    )  # fmt: skip
    probability = _probability(0.5 * (found.excess / found.deviation) ** 2)
    decision.effects.append(Named(term, "stribeck", joint, probability, [], found.words, table, theta))
    decision.rejected = [r for r in decision.rejected if (r["name"], r["joint"]) != ("stribeck", joint)]
    decision.verdict = "physics_missing"


def _probability(odds: float) -> float:
    """Of what stands against nothing at all, from its log odds."""
    return CEILING / (1.0 + float(np.exp(-min(odds, 30.0))))


def add_drift(problem: Problem, search: Search, decision: Decision) -> None:
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
        s, j = drift.blocks[0].session, drift.blocks[0].joint
        joint = problem.ctx.model.joints[j]
        half = Z90 * float(np.hypot(deviation, MODEL_ERROR + DRIFT_ERROR * abs(share)))
        own = Z90 * float(np.sqrt(covariance[0, 0]))
        table = {
            "factor": table_entry(1.0 + share, half, "1"),
            f"change_{s.rec.session}": table_entry(
                float(change[0]), own, problem.ctx.model.effort_unit(joint)
            ),
        }
        named = Named(
            Term("session_friction", j), "session_friction", joint, _probability(odds), [],
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
