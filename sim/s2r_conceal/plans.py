"""What to draw: groups of cases, their variants, hidden effects and strengths, and the verdicts that are right."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from s2r_conceal.effects.table import EFFECTS, KNOWN, UNKNOWN
from s2r_conceal.rigs import Rig

STRENGTHS = (1.5, 3.0, 10.0)
GROUPS = ("single", "clean", "unknown", "pairs", "triples", "masked", "insufficient", "wrong_log")
CLEAN_VARIANTS = ("plain", "parameter_off", "in_model")
INSUFFICIENT_VARIANTS = ("still", "one_way", "crawl")
MASKED_VARIANTS = ("high_gain", "no_effort")
WRONG_LOGS = ("other_robot", "degrees", "swapped_joints")

Plan = tuple[str, tuple[str, ...], float]  # variant, effect names, strength


def possible(rig: Rig) -> tuple[str, ...]:
    """Catalogue names that this rig can show."""
    return tuple(n for n in KNOWN if EFFECTS[n].min_joints <= rig.joints)


def plans_of(rng: np.random.Generator, rig: Rig, group: str, count: int) -> Iterator[Plan]:
    """(variant, effect names, strength) of each case of a group, evenly spread."""
    names = possible(rig)
    match group:
        case "single" | "masked":
            combos = list(itertools.product(names, STRENGTHS if group == "single" else (3.0, 10.0)))
            picks = _cycle(rng, combos, count)
            variants = ("",) if group == "single" else MASKED_VARIANTS
            yield from ((variants[k % len(variants)], (name,), s) for k, (name, s) in enumerate(picks))
        case "unknown":
            combos = list(itertools.product(UNKNOWN, (3.0, 10.0)))
            yield from (("", (name,), s) for name, s in _cycle(rng, combos, count))
        case "pairs" | "triples":
            size = 2 if group == "pairs" else 3
            yield from (
                ("", _together(rng, names, size), float(rng.choice([4.0, 10.0]))) for _ in range(count)
            )
        case "clean":
            yield from ((CLEAN_VARIANTS[k % 3], (), 0.0) for k in range(count))
        case "insufficient":
            yield from ((INSUFFICIENT_VARIANTS[k % 3], (str(rng.choice(names)),), 0.7) for k in range(count))
        case _:
            # Another arm of the same make differs by its masses only, which is no wrong log.
            kinds = {1: WRONG_LOGS[:2], 2: WRONG_LOGS}.get(rig.joints, WRONG_LOGS[1:])
            yield from ((kinds[k % len(kinds)], (), 0.0) for k in range(count))


def _cycle(rng: np.random.Generator, items: list, count: int) -> list:
    """``count`` items, every one used before any is used again."""
    picked: list = []
    while len(picked) < count:
        picked += [items[i] for i in rng.permutation(len(items))]
    return picked[:count]


def _together(rng: np.random.Generator, names: tuple[str, ...], size: int) -> tuple[str, ...]:
    """Names that are not declared to look alike, and at most one compliant transmission."""
    transmissions = {"backlash", "joint_elasticity"}
    while True:
        picked = tuple(str(n) for n in rng.choice(names, size, replace=False))
        alike = any(b in EFFECTS[a].same_as for a in picked for b in picked)
        if not alike and len(transmissions & set(picked)) < 2:
            return picked


def expected_verdicts(group: str, variant: str) -> tuple[str, ...]:
    """Verdicts (or ``refused``) that are right for a case of this group and variant whose effort is recorded."""
    match group, variant:
        case "clean", "parameter_off":
            return ("parameter_off",)
        case "clean", _:
            return ("nothing_missing",)
        case "unknown", _:
            return ("unknown",)
        case "insufficient", _:
            return ("insufficient",)
        case "wrong_log", _:
            return ("refused", "unknown")
        case _:
            return ("physics_missing",)
