"""Objects with one effect that the host's belief leaves out, each strong enough for the arm's force gauge to feel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_sim.objects.drawer import RUNNER_M, Slop
from s2r_sim.objects.effects import JointEffects
from s2r_sim.objects.laptop import draw_bend
from s2r_sim.objects.parameters import uniform
from s2r_sim.paper.trials import Trial, draw_simple_trial

FIRST_TRIAL = 5_000  # far from the numbers of the accuracy table
_SALT = 68
# Changes that show an effect along the way at least once [m or rad].
_LEAST_CHANGE = {"drawer": 0.08, "laptop": math.radians(25), "faucet": math.radians(18)}
_PLACES = 97  # numbers are this far apart: further draws of the same case, until one has room to move

MATTERS = 0.01
"""Shift of the end, as a share of the change asked for, from which on an effect matters to a fingertip."""
PART = {"drawer": "drawer", "laptop": "lid", "faucet": "lever"}
"""Names of the kinds in ``tests/bench/bench_left_out.py``."""
LEARNING = (1.0, 0.1, 0.9)
"""Targets from which the physics is learnt, in shares of the change, from where the first push leaves the part."""
LATER = (0.0, 1.0, 0.2, 0.85, 0.05, 0.95, 0.15, 0.9, 0.1, 1.0)
"""Targets on which it is tried."""


@dataclass(frozen=True)
class Hidden:
    """One effect on one kind of object.

    Attributes:
        kind: Of object.
        effect: What is hidden.
        names: Answers of the gap tool that count as its name; empty: nothing is hidden.
        place: Decides the numbers of its objects; never given twice, whatever cases come or go.
        change: What an object gets: object parameters and joint effects.
        like: The row of ``tests/bench/bench_left_out.py`` that is nearest to it; None: that bench has none.
    """

    kind: str
    effect: str
    names: tuple[str, ...]
    place: int
    change: Callable[[np.random.Generator, Any], tuple[dict[str, Any], JointEffects]]
    like: str | None = None

    @property
    def label(self) -> str:
        """E.g. ``drawer: stiction``."""
        return f"{self.kind}: {self.effect}"


def _nothing(rng: np.random.Generator, spec: Any) -> tuple[dict[str, Any], JointEffects]:
    return _drawer_friction(rng, spec), JointEffects()


def _profile(rng: np.random.Generator, spec: Any) -> tuple[dict[str, Any], JointEffects]:
    drawer = spec.kind == "drawer"
    return _drawer_friction(rng, spec), JointEffects(
        profile=uniform(rng, 1.2, 2.0) if drawer else uniform(rng, 0.6, 1.2),
        profile_length=uniform(rng, 0.04, 0.08)
        if drawer
        else uniform(rng, math.radians(14), math.radians(25)),
        profile_phase_rad=uniform(rng, -math.pi, math.pi),
    )


def _stiction(rng: np.random.Generator, spec: Any) -> tuple[dict[str, Any], JointEffects]:
    speed = 0.02 if spec.kind == "drawer" else 0.1
    return _drawer_friction(rng, spec), JointEffects(stiction=uniform(rng, 0.8, 1.5), stiction_speed=speed)


def _pull(rng: np.random.Generator, spec: Any) -> tuple[dict[str, Any], JointEffects]:
    new = _drawer_friction(rng, spec)
    return new, JointEffects(pull=round(new["coulomb_N"] * uniform(rng, 0.5, 0.85), 6))


def _rail_play(rng: np.random.Generator, spec: Any) -> tuple[dict[str, Any], JointEffects]:
    play = {
        "play_m": uniform(rng, 0.002, 0.004),
        "play_rad": uniform(rng, math.radians(0.6), math.radians(1.2)),
    }
    return {**_drawer_friction(rng, spec), **play}, JointEffects()


def _slop(rng: np.random.Generator, spec: Any) -> tuple[dict[str, Any], JointEffects]:
    """As much as the springy play of its own case, with nothing that leads back."""
    friction = uniform(rng, 0.2, 0.6)
    slop = Slop(
        sideways_m=uniform(rng, 0.002, 0.004),
        yaw_rad=uniform(rng, math.radians(0.6), math.radians(1.2)),
        pitch_rad=uniform(rng, math.radians(0.3), math.radians(0.6)),
        friction_N=friction,
        friction_Nm=round(friction * RUNNER_M, 6),
    )
    return {**_drawer_friction(rng, spec), "slop": slop}, JointEffects()


def _flexible(rng: np.random.Generator, spec: Any) -> tuple[dict[str, Any], JointEffects]:
    """A lid softer than those of the accuracy table: 5 N at its far edge bend it by 3 to 9°."""
    bend = draw_bend(rng, spec, (6.0, 9.0))
    return {"bend": bend}, JointEffects()


def _detent(rng: np.random.Generator, spec: Any) -> tuple[dict[str, Any], JointEffects]:
    coulomb = uniform(rng, 0.35, 0.6)
    return {"coulomb": coulomb}, JointEffects(
        detent=round(coulomb * uniform(rng, 0.75, 0.95), 6),
        detent_pitch=uniform(rng, math.radians(8), math.radians(14)),
    )


def _drawer_friction(rng: np.random.Generator, spec: Any) -> dict[str, Any]:
    """Dry friction of a drawer well above the gauge's noise; hinges keep theirs."""
    return {"coulomb_N": uniform(rng, 2.0, 4.0)} if spec.kind == "drawer" else {}


_CONSTANT = ("gravity_tilt", "asymmetric_friction", "spring_return", "cable_spring")
HIDDEN = {
    hidden.label: hidden
    for hidden in (
        Hidden("drawer", "nothing", (), 2, _nothing),
        Hidden("drawer", "friction profile", ("cogging",), 1, _profile, "profile 1 to 3"),
        Hidden("drawer", "stiction", ("stribeck",), 4, _stiction, "stiction + 100 %"),
        Hidden("drawer", "closing spring below friction", _CONSTANT, 0, _pull, "pull back 0.6"),
        Hidden("drawer", "rail play", ("joint_play", "backlash"), 3, _rail_play),
        Hidden("laptop", "nothing", (), 9, _nothing),
        Hidden("laptop", "friction profile", ("cogging",), 8, _profile, "profile 1 to 3"),
        Hidden("faucet", "nothing", (), 6, _nothing),
        Hidden("faucet", "detent", ("cogging", "detent"), 5, _detent, "detent 0.7"),
        Hidden("faucet", "stiction", ("stribeck",), 7, _stiction, "stiction + 100 %"),
        Hidden("drawer", "slop", ("joint_play", "backlash"), 10, _slop),
        Hidden("laptop", "flexible lid", ("flexible_part", "joint_elasticity"), 11, _flexible),
    )
}


def draw_case(label: str, number: int, salt: str | None = None) -> Trial:
    """The object of that case and number, as a trial: world, and how far its part is moved at most [m or rad].

    The same label and number give the same object; the salt of its seal is fresh unless given.
    """
    hidden = HIDDEN[label]
    first = FIRST_TRIAL + 1000 * hidden.place + _PLACES * number
    trial = next(
        one
        for one in (draw_simple_trial(hidden.kind, k, salt) for k in range(first, first + _PLACES))
        if abs(one.change) >= _LEAST_CHANGE[hidden.kind]
    )
    rng = np.random.default_rng([_SALT, hidden.place, number])
    parameters, effects = hidden.change(rng, trial.world.object)
    world = trial.world.model_copy(
        update={"object": trial.world.object.model_copy(update=parameters), "effects": effects}
    )
    return Trial(hidden.kind, trial.number, world, trial.change)
