"""Which manipulations are asked for: a concealed object at a random place and state, and how far to move its part."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from s2r_protocol.arms import ArmDescription
from s2r_sim.objects.effects import draw_effects
from s2r_sim.objects.parameters import uniform
from s2r_sim.paper.concealed import conceal
from s2r_sim.world import WorldSpec, draw_world

KINDS = ("drawer", "laptop", "faucet")
FIRST_WORLD = 100_000  # worlds of smaller seeds were looked at during development
_SALT = 8
_MARGINS = {
    "drawer": 0.01,
    "laptop": math.radians(3),
    "faucet": math.radians(3),
}  # kept from the stops [m or rad]


@dataclass(frozen=True)
class Trial:
    """One manipulation.

    Attributes:
        kind: Of object.
        number: Of the trial.
        world: All that is hidden.
        change: How far the part is to be moved from where the pushes leave it [m or rad]; see :meth:`asked`.
    """

    kind: str
    number: int
    world: WorldSpec
    change: float

    def asked(self, s: float, sense: float) -> float:
        """The change to ask for: as drawn where that stays within the joint's limits.

        Where pushes took the part nearer to a stop than the draw allows for, as far the other way; where that does not
        fit either, to the stop that is further away. Margins are kept from both.

        Args:
            s: The true joint as the pushes are said to have left it [m or rad].
            sense: 1 if the host's joint grows as the true one, -1 if it is the other way round.

        Returns:
            Counted as the host's joint [m or rad].
        """
        margin = _MARGINS[self.kind]
        low, high = margin - s, self.world.object.q_max - margin - s
        for change in (self.change, -self.change):
            if low <= sense * change <= high:
                return change
        return sense * (high if high > -low else low)


def draw_trial(kind: str, number: int, salt: str | None = None, arm: ArmDescription | None = None) -> Trial:
    """The trial of that number: place, size, physics, state as found and direction are random.

    The change keeps within the joint's limits wherever a usual first push (45 mm in, 25° either way) leaves the part;
    for other pushes there is :meth:`Trial.asked`. Object, camera and change are the same for every arm. What
    :mod:`s2r_sim.paper.concealed` adds is drawn apart: all else is as in :func:`draw_simple_trial`.
    """
    trial = draw_simple_trial(kind, number, salt, arm)
    return replace(trial, world=conceal(trial.world, KINDS.index(kind), number, arm))


def draw_simple_trial(
    kind: str, number: int, salt: str | None = None, arm: ArmDescription | None = None
) -> Trial:
    """The same without what is beyond friction, rail play, notches and errors of arm and camera."""
    rng = np.random.default_rng([_SALT, KINDS.index(kind), number])
    world = draw_world(FIRST_WORLD + number, kind, salt, arm)
    change = 0.0
    start: tuple[float, float] | None = None
    while start is None:
        change, start = _RULES[kind](rng, world.object)
    q_start = uniform(rng, *start)
    effects = draw_effects(rng, kind, _coulomb(world.object))
    hidden = world.object.model_copy(update=_found_at(world.object, q_start))
    return Trial(kind, number, world.model_copy(update={"object": hidden, "effects": effects}), change)


Start = tuple[float, tuple[float, float] | None]


def _drawer(rng: np.random.Generator, spec: Any) -> Start:
    change, push = _signed(rng, 0.04, 0.15), 0.045
    low = push + 0.01 + max(0.0, -change)
    return change, _span(low, spec.q_max - 0.02 - max(0.0, change) if change < 0.0 else low + 0.10)


def _laptop(rng: np.random.Generator, spec: Any) -> Start:
    change, push = _signed(rng, math.radians(10), math.radians(45)), math.radians(25)
    low = max(math.radians(45), math.radians(5) + push + max(0.0, -change))
    return change, _span(low, min(math.radians(115), spec.q_max - math.radians(5) - push - max(0.0, change)))


def _faucet(rng: np.random.Generator, spec: Any) -> Start:
    change, push = _signed(rng, math.radians(10), math.radians(30)), math.radians(25)
    return change, _span(
        math.radians(3) + push + max(0.0, -change), spec.q_max - math.radians(3) - push - max(0.0, change)
    )


_RULES: dict[str, Callable[[np.random.Generator, Any], Start]] = {
    "drawer": _drawer,
    "laptop": _laptop,
    "faucet": _faucet,
}


def _signed(rng: np.random.Generator, low: float, high: float) -> float:
    size = uniform(rng, low, high)
    return size if rng.uniform() < 0.5 else -size


def _span(low: float, high: float) -> tuple[float, float] | None:
    return (low, high) if low <= high else None


def _coulomb(spec: Any) -> float:
    return spec.coulomb_N if spec.kind == "drawer" else spec.coulomb


def _found_at(spec: Any, q_start: float) -> dict[str, float]:
    """What changes in an object's parameters when it is found elsewhere; a drawer's front keeps its place."""
    if spec.kind == "drawer":
        return {"opening_m": q_start, "x_front_m": round(spec.x_front_m - spec.opening_m + q_start, 6)}
    return {"q_start": q_start}
