"""What may be hidden in an object's joint, and how such objects are drawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from math import exp
from typing import Any

import numpy as np

from s2r_sim.missing.cases import draw_case
from s2r_sim.objects.effects import JointEffects
from s2r_sim.objects.parameters import uniform
from s2r_sim.paper.trials import Trial


class SealedEffects(JointEffects):
    """Further effects of a joint. Units N, m or N·m, rad.

    Attributes:
        asymmetry: Dry friction is larger by this share where the joint value falls.
        viscous: Added friction per speed [N·s/m or N·m·s/rad].
        spring: Pull towards joint value 0 per joint value [N/m or N·m/rad].
        latch: Largest force or torque of one catch [N or N·m].
        latch_place: Joint value that it draws the part to [m or rad].
        latch_width: From there to where it pulls most [m or rad].
    """

    asymmetry: float = 0.0
    viscous: float = 0.0
    spring: float = 0.0
    latch: float = 0.0
    latch_place: float = 0.0
    latch_width: float = 1.0

    @property
    def none(self) -> bool:
        """Nothing is added."""
        return super().none and self.asymmetry == self.viscous == self.spring == self.latch == 0.0

    def friction(self, coulomb: float, s: float, v: float) -> float:
        """As the parent's, direction and speed counted: what grows with the speed only ever brakes, too."""
        one_way = 1.0 + self.asymmetry * (v < 0.0)
        return super().friction(coulomb, s, v) * one_way + self.viscous * abs(v)

    def force(self, s: float) -> float:
        """As the parent's, with spring and catch."""
        x = (s - self.latch_place) / self.latch_width
        return super().force(s) - self.spring * s - self.latch * x * exp(0.5 * (1.0 - x * x))


PULLS = ("gravity_tilt", "asymmetric_friction", "spring_return", "cable_spring")
"""A steady pull below dry friction is a friction that differs by direction, and the other way round."""
SPRINGS = ("spring_return", "cable_spring")
Change = Callable[[np.random.Generator, Trial, float], tuple[dict[str, Any], JointEffects]]


@dataclass(frozen=True)
class Hidden:
    """One effect.

    Attributes:
        names: Answers that count as its name; empty: nothing that a belief with its own mass, friction and damping
            leaves out.
        kinds: Of objects that may have it.
        change: Generator, object and its dry friction -> object parameters and joint effects.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    change: Change


def _nothing(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    return {}, SealedEffects()


def _numbers(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    slides = trial.kind == "drawer"
    damping = uniform(rng, 15.0, 40.0) if slides else uniform(rng, 0.6, 1.5) * dry
    mass = trial.world.object.mass_kg * uniform(rng, 1.3, 2.0)
    return {"mass_kg": round(mass, 6)} if slides else {}, SealedEffects(viscous=round(damping, 6))


def _stiction(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    slow = uniform(rng, 0.015, 0.03) if trial.kind == "drawer" else uniform(rng, 0.07, 0.15)
    return {}, SealedEffects(stiction=uniform(rng, 0.8, 1.5), stiction_speed=slow)


def _profile(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    slides = trial.kind == "drawer"
    length = uniform(rng, 0.04, 0.08) if slides else math.radians(uniform(rng, 14.0, 25.0))
    return {}, SealedEffects(
        profile=uniform(rng, 1.2, 2.0) if slides else uniform(rng, 0.6, 1.2),
        profile_length=round(length, 6),
        profile_phase_rad=uniform(rng, -math.pi, math.pi),
    )


def _detent(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    slides = trial.kind == "drawer"
    pitch = uniform(rng, 0.02, 0.04) if slides else math.radians(uniform(rng, 8.0, 14.0))
    return {}, SealedEffects(detent=round(dry * uniform(rng, 0.75, 0.95), 6), detent_pitch=round(pitch, 6))


def _latch(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    spec: Any = trial.world.object
    slides = trial.kind == "drawer"
    pushed = spec.opening_m - 0.045 if slides else spec.q_start  # a first push goes in, or either way
    width = uniform(rng, 0.006, 0.012) if slides else math.radians(uniform(rng, 2.5, 5.0))
    return {}, SealedEffects(
        latch=round(dry * uniform(rng, 0.75, 0.95), 6),
        latch_place=round(pushed + uniform(rng, 0.35, 0.65) * trial.change, 6),
        latch_width=round(width, 6),
    )


def _pull(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    return {}, SealedEffects(pull=round(dry * uniform(rng, 0.5, 0.85), 6))


def _spring(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    spec: Any = trial.world.object
    most = spec.range_m if trial.kind == "drawer" else spec.q_max
    return {}, SealedEffects(spring=round(dry * uniform(rng, 0.7, 0.9) / most, 6))


def _asymmetric(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    return {}, SealedEffects(asymmetry=uniform(rng, 0.6, 1.2))


def _rail_play(rng: np.random.Generator, trial: Trial, dry: float) -> tuple[dict[str, Any], JointEffects]:
    play = {"play_m": uniform(rng, 0.002, 0.004), "play_rad": math.radians(uniform(rng, 0.6, 1.2))}
    return {name: round(value, 6) for name, value in play.items()}, SealedEffects()


ALL = ("drawer", "laptop", "faucet")
LIGHT = ("drawer", "faucet")  # a lid's friction has to hold its weight: nothing else may pull as hard
HIDDEN = {
    "nothing": Hidden((), ALL, _nothing),
    "mass and damping": Hidden((), ALL, _numbers),
    "stiction": Hidden(("stribeck",), ALL, _stiction),
    "friction profile": Hidden(("cogging",), ALL, _profile),
    "detent": Hidden(("cogging", "detent"), LIGHT, _detent),
    "latch": Hidden(("detent", "cogging"), LIGHT, _latch),
    "steady pull": Hidden(PULLS, LIGHT, _pull),
    "spring": Hidden(SPRINGS, LIGHT, _spring),
    "asymmetric friction": Hidden(PULLS, ALL, _asymmetric),
    "rail play": Hidden(("joint_play", "backlash"), ("drawer",), _rail_play),
}
_FIRST = 20_000  # far from the numbers of `s2r bench missing`
_SPREAD = 10_000
_FAUCET_FRICTION = (0.3, 0.6)  # N·m: well above the gauge's noise


def draw(effect: str, index: int, seed: int) -> Trial:
    """The object with that effect and that index in its set; kinds take turns.

    Args:
        effect: Key of ``HIDDEN``.
        index: Among the objects with this effect.
        seed: Of the set.
    """
    hidden = HIDDEN[effect]
    place = list(HIDDEN).index(effect)
    rng = np.random.default_rng([seed, place, index])
    kind = hidden.kinds[index % len(hidden.kinds)]
    trial = draw_case(f"{kind}: nothing", _FIRST + int(rng.integers(_SPREAD)))
    spec: Any = trial.world.object
    usual = {"coulomb": uniform(rng, *_FAUCET_FRICTION)} if kind == "faucet" else {}
    dry = float(spec.coulomb_N if kind == "drawer" else (usual or spec.model_dump())["coulomb"])
    change, effects = hidden.change(rng, trial, dry)
    world = trial.world.model_copy(
        update={"object": spec.model_copy(update=usual | change), "effects": effects}
    )
    return Trial(kind, trial.number, world, trial.change)
