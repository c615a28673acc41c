"""One effect as answered: its probability, what else it could be, its parameters with intervals."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from s2r_host.gap.regression.base_terms import PREFIX
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Scored, Solution, Term
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.intervals import MODEL_ERROR, Z90, parameter_table

HEAT, CEILING = 0.001, 0.98
ALIKE_HEAT = 2.0  # between effects that are declared alike
CLOSE = 8.0  # nats by which an effect that is declared alike may be behind
LEAST_TOLD = 0.005  # of the held-out misfit: less is told as evidence
SET_LEAST = 0.01  # probability from which a rival belongs to the set
CLEAR_DEVIATIONS = 5.0  # of a size, before what it belongs to is named beside
EQUIVALENT = (
    ("gravity_tilt", "encoder_offset"),
    ("actuator_delay", "bandwidth"),
    ("presliding", "hysteresis"),
    ("payload", "spring_return"),
    ("payload", "effort_scale"),
    ("cable_spring", "spring_return"),
    ("joint_elasticity", "flexible_part"),
)
# What moves on a spring behind an encoder at the motor is link or part: all that differs is where friction sits.
BEHIND, BEHIND_MARGIN = ("joint_elasticity", "flexible_part"), 0.15


@dataclass
class Named:
    """One effect as answered."""

    term: Term
    name: str
    joint: str
    probability: float
    could_also_be: list[str]
    evidence: str
    parameters: dict[str, dict]
    theta: np.ndarray
    log_odds: dict[str, float] = field(default_factory=dict)

    def as_json(self, together: bool) -> dict:
        """The contract's form."""
        found = {
            "name": self.name,
            "joint": self.joint,
            "probability": round(self.probability, 4),
            "could_also_be": self.could_also_be,
            "evidence": self.evidence,
            "parameters": self.parameters,
            "log_odds": {n: round(x, 2) for n, x in self.log_odds.items()},
        }
        return found | ({"together": True} if together else {})


def named_effect(problem: Problem, search: Search, solution: Solution, i: int, slot: list[Scored]) -> Named:
    """Term ``i`` of a solution with probability, rivals and parameters, from what was weighed for its place."""
    term = solution.terms[i]
    probabilities = slot_probabilities(search, slot)
    own = probabilities.get(term.key, CEILING)
    others = sorted(((p, k) for k, p in probabilities.items() if k != term.key), reverse=True)
    also = [k[0] for p, k in others if p > SET_LEAST and k[0] != term.effect and not k[0].startswith(PREFIX)]
    for group in EQUIVALENT:
        if term.effect in group:
            margin = BEHIND_MARGIN if group == BEHIND else 0.0
            also += [n for n in group if n != term.effect and n not in also and _close(slot, n, margin)]
    joint = "" if term.joint < 0 else problem.ctx.model.joints[term.joint]
    if term.effect == "payload":
        joint = problem.ctx.model.joint_that_moves(int(dict(term.shape)["body"]))
    elif term.joint < 0 and not term.effect.startswith(PREFIX):
        joint = problem.ctx.model.joints[0]
    return Named(
        term, term.effect, joint, own, also[:1], evidence_told(term, slot),
        parameter_table(problem, search, solution, i), solution.theta[i], rival_odds(slot),
    )  # fmt: skip


def evidence_told(term: Term, slot: list[Scored]) -> str:
    """What speaks for a term in its place: what it takes of the held-out misfit, and what the next best would."""
    own = next((s for s in slot if s.term.key == term.key), None)
    if own is None or own.holdout_gain < LEAST_TOLD:
        nats = 0.0 if own is None else own.gain
        return (
            f"{nats:.0f} nats of evidence for this cause instead of several numbers that moved a little each"
        )
    text = (
        f"removes {own.holdout_gain:.0%} of the squared misfit in effort, on held-out motion, that shifted numbers and "
        "the other names leave"
    )
    runner = next((s for s in slot if s.term.key != term.key), None)
    if runner is None:
        return text
    return (
        f"{text}; the next best, {runner.term.effect.removeprefix(PREFIX)}, removes {runner.holdout_gain:.0%}"
    )


def brought(problem: Problem, search: Search, solution: Solution, i: int, named: Named) -> list[Named]:
    """Simpler effects that term ``i`` holds because the model lacks them, where their size is clear."""
    term, found = solution.terms[i], []
    theta, effect = solution.theta[i], search.effects[term.effect]
    for name, weights in effect.brings(problem.ctx, term.joint, dict(term.shape), theta).items():
        w = np.zeros(len(theta))
        w[: len(weights)] = weights
        size, variance = np.array([w @ theta]), float(w @ solution.covariance[i] @ w)
        if name not in search.effects or any(t.key == (name, term.joint) for t in solution.terms):
            continue  # it has a place of its own
        if not size[0] > CLEAR_DEVIATIONS * np.sqrt(variance):
            continue
        values = search.effects[name].parameters(problem.ctx, term.joint, {}, size)
        table = {}
        for key, value in values.items():
            half = Z90 * float(np.hypot(np.sqrt(variance), MODEL_ERROR * size[0]))
            ends = [float(value.value) - half, float(value.value) + half]
            table[key] = {
                "value": float(value.value),
                "unit": value.unit,
                "interval90": ends,
                "identifiable": True,
            }
        why = f"the model has none; found as a part of {term.effect}"
        found.append(
            Named(Term(name, term.joint), name, named.joint, 0.99 * named.probability, [], why, table, size)
        )
    return found


def rival_odds(slot: list[Scored]) -> dict[str, float]:
    """Log odds of the best explanations of one place by name, nothing at all being zero."""
    found: dict[str, float] = {}
    for s in sorted(slot, key=lambda s: -s.gain)[:8]:
        found.setdefault(s.term.effect.removeprefix(PREFIX), float(s.gain))
    return found


def slot_probabilities(search: Search, slot: list[Scored]) -> dict[tuple[str, int], float]:
    """Probability of everything that may stand in one place, 'nothing' and 'none of these' included.

    The models behind two explanations err in proportion to the gap, so the difference of their log odds counts
    less the larger the gap is; not so for an explanation that contains the winner, where only the extra part errs.
    Between effects that are declared alike it counts less still: a true drive is neither a pure delay nor a pure lag.
    ``CEILING`` is what the tuning set says of a first name without rivals.
    """
    if not slot:
        return {}
    scores = {s.term.key: s.gain for s in slot}
    winner = max(scores, key=lambda k: scores[k])
    top = scores[winner]
    weights = {("", 0): float(np.exp(max(-top, -60.0)))}
    for key, gain in scores.items():
        contains = winner[0] in search.effects[key[0]].contains
        cooled = 1.0 if contains else cooling(top, winner[0], key[0])
        weights[key] = float(np.exp(max((gain - top) / cooled, -60.0)))
    total = sum(weights.values())
    return {k: CEILING * w / total for k, w in weights.items() if k[0]}


def cooling(top: float, winner: str, other: str) -> float:
    """By how much a lead of log odds counts less, where ``top`` are the winner's against nothing at all."""
    return 1.0 + HEAT * max(top, 0.0) + (ALIKE_HEAT if alike(winner, other) else 0.0)


def alike(one: str, other: str) -> bool:
    """Are two effects declared to look alike?"""
    return one != other and any(one in group and other in group for group in EQUIVALENT)


def _close(slot: list[Scored], name: str, share: float) -> bool:
    best = max((s.gain for s in slot), default=0.0)
    return any(s.term.effect == name and s.gain > best - max(CLOSE, share * best) for s in slot)
