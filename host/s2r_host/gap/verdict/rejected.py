"""What was weighed and not named, each with its reason."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects import catalogue
from s2r_host.gap.regression.base_terms import PREFIX
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Scored, Solution
from s2r_host.gap.search.search import MIN_GAIN, Search

LEAST_HELD = 0.01  # of the held-out misfit: less is no improvement
# What a wrong number of the model is called among the effects, where that is another name.
AS_EFFECT = {"payload_mass": "payload", "frictionloss": "coulomb_friction", "damping": "viscous_friction"}
_AT_FLOOR = "the model, its numbers moved a little, already reaches the noise floor"


def rejected_list(problem: Problem, search: Search, solution: Solution) -> list[dict]:
    """Everything weighed but not chosen, the closest first, then what could not act or be seen."""
    chosen = {t.key for t in solution.terms}
    seen: dict[tuple[str, int], Scored] = {}
    won: dict[tuple[str, int], float] = {}
    for slot in [solution.scans, *solution.slots]:
        for s in slot:
            if s.term.key not in chosen and not s.term.effect.startswith(PREFIX):
                seen[s.term.key] = s
                won[s.term.key] = slot[0].holdout_gain
    found = []
    for key, s in sorted(seen.items(), key=lambda x: -x[1].holdout_gain):
        found.append(_entry(problem, key, s.holdout_gain, _why(s, won[key])))
    return found + _blocked(problem, search)


def without_answered(rejected: list[dict], effects: list[dict], off: list[dict]) -> list[dict]:
    """Rejected entries without what the answer names, or holds possible, at the same joint.

    What one search rejects another may name, e.g. once the recorded effort was held against the control law; and a
    number that is off (a motor's inertia) may be an effect of the catalogue as well.

    Args:
        rejected: Entries with ``name`` and ``joint``.
        effects: As answered, with ``name``, ``joint`` and ``could_also_be``.
        off: Entries of ``parameters_off`` with ``name``, ``joint`` (beside a ``body`` the one that moves it) and maybe
            ``could_also_be``.
    """
    named = {
        (AS_EFFECT.get(name, name), e["joint"])
        for e in [*effects, *off]
        for name in (e["name"], *e.get("could_also_be", ()))
    }
    whole = {name for name, _ in named if name in catalogue() and catalogue()[name].scope == "model"}
    return [r for r in rejected if r["name"] not in whole and (r["name"], r["joint"]) not in named]


def _why(s: Scored, won: float) -> str:
    """The reason against an explanation of a place whose winner takes a share ``won`` of the held-out misfit."""
    if s.holdout_gain < LEAST_HELD:
        return "does not improve held-out data"
    if s.gain <= MIN_GAIN:
        return "no evidence"
    if s.holdout_gain > won:
        return "predicts held-out data as well as the winner, but has less evidence in all"
    return "improves held-out data by less than the winner"


def _entry(problem: Problem, key: tuple[str, int], gain: float, why: str) -> dict:
    joint = problem.ctx.model.joints[max(key[1], 0)]
    return {
        "name": key[0],
        "joint": joint,
        "holdout_gain": round(float(np.clip(gain, -99, 1)), 4),
        "why": why,
    }


def _blocked(problem: Problem, search: Search) -> list[dict]:
    found = []
    for name, effect in search.effects.items():
        if name.startswith(PREFIX):
            continue
        for j in problem.joints if effect.scope == "joint" else [-1]:
            if not effect.applies(problem.ctx, j):
                found.append(
                    _entry(problem, (name, j), 0.0, "cannot act here with this model and these channels")
                )
                continue
            reason = effect.blocked(problem.ctx, j)
            if reason:
                found.append(_entry(problem, (name, j), 0.0, f"cannot be seen: {reason}"))
    return found


def rejected_at_floor(problem: Problem, search: Search) -> list[dict]:
    """The whole catalogue, when the model reaches the noise floor without any of it."""
    keys = [key for key in search.candidates() if not key[0].startswith(PREFIX)]
    found = [_entry(problem, key, 0.0, _AT_FLOOR) for key in keys]
    return found + _blocked(problem, search)


def was_weighed(why: str) -> bool:
    """Whether a reason of the list was found by trying the effect, so that its gain is a measured one."""
    return why != _AT_FLOOR and not why.startswith("cannot ")
