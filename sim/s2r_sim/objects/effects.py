"""Joint effects that no belief of the host has: stiction, friction that changes along the way, detents."""

from __future__ import annotations

from math import exp, pi, sin

import numpy as np
from pydantic import Field

from s2r_sim.objects.parameters import Parameters, uniform


class JointEffects(Parameters):
    """On top of Coulomb and viscous friction; all zero leaves the joint as it is. Units N, m or N·m, rad.

    Attributes:
        stiction: Extra dry friction at rest, as a share of Coulomb friction (Stribeck curve).
        stiction_speed: It falls to 1/e at this speed [m/s or rad/s].
        profile: Dry friction grows and shrinks along the way between 1 and 1 + profile times its value.
        profile_length: Way after which that repeats [m or rad].
        profile_phase_rad: Where it begins.
        detent: Largest force or torque of the notches [N or N·m].
        detent_pitch: From notch to notch [m or rad].
        pull: Force or torque towards joint value 0 along the whole way, as of a spring that closes a drawer.
    """

    stiction: float = Field(default=0.0, ge=0.0)
    stiction_speed: float = Field(default=0.02, gt=0.0)
    profile: float = Field(default=0.0, ge=0.0)
    profile_length: float = Field(default=1.0, gt=0.0)
    profile_phase_rad: float = 0.0
    detent: float = Field(default=0.0, ge=0.0)
    detent_pitch: float = Field(default=1.0, gt=0.0)
    pull: float = Field(default=0.0, ge=0.0)

    @property
    def none(self) -> bool:
        """Nothing is added."""
        return self.stiction == self.profile == self.detent == self.pull == 0.0

    def friction(self, coulomb: float, s: float, v: float) -> float:
        """Dry friction [N or N·m] at joint value ``s`` and speed ``v``."""
        along = 1.0 + 0.5 * self.profile * (
            1.0 + sin(2.0 * pi * s / self.profile_length + self.profile_phase_rad)
        )
        return coulomb * along * (1.0 + self.stiction * exp(-((v / self.stiction_speed) ** 2)))

    def detent_force(self, s: float) -> float:
        """Force or torque towards the nearest notch [N or N·m]."""
        return -self.detent * sin(2.0 * pi * s / self.detent_pitch)

    def force(self, s: float) -> float:
        """All that depends on the joint value alone [N or N·m]."""
        return self.detent_force(s) - self.pull


def draw_effects(rng: np.random.Generator, category: str, coulomb: float) -> JointEffects:
    """Draw effects that are usual for a kind of object.

    Detents stay below dry friction: a lever let go stays where it is.
    """
    if category == "drawer":
        return JointEffects(
            stiction=uniform(rng, 0.0, 0.5),
            profile=uniform(rng, 0.0, 0.4),
            profile_length=uniform(rng, 0.05, 0.3),
            profile_phase_rad=uniform(rng, -np.pi, np.pi),
        )
    if category == "faucet":
        return JointEffects(
            stiction=uniform(rng, 0.1, 0.6),
            detent=round(coulomb * uniform(rng, 0.0, 0.5), 6),
            detent_pitch=uniform(rng, np.deg2rad(6), np.deg2rad(20)),
        )
    return JointEffects(
        stiction=uniform(rng, 0.0, 0.3),
        profile=uniform(rng, 0.0, 0.4),
        profile_length=uniform(rng, np.deg2rad(20), np.deg2rad(90)),
        profile_phase_rad=uniform(rng, -np.pi, np.pi),
    )
