"""What the builder believes about physics it cannot see: value and 90 % interval of each parameter."""

from __future__ import annotations

from dataclasses import dataclass

from s2r_protocol.targets import JointType


@dataclass(frozen=True)
class Guess:
    """A value with its 90 % interval, SI units."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Physics:
    """Priors of one joint.

    Attributes:
        frictionloss: Coulomb friction of the joint [N or N·m].
        damping: Viscous friction [N·s/m or N·m·s/rad].
        armature: Added inertia that keeps light parts well conditioned [kg or kg·m²].
        density_kg_m3: Of all pieces.
        surface_friction: Sliding friction between the fingertip and the object.
    """

    frictionloss: Guess
    damping: Guess
    armature: float
    density_kg_m3: Guess
    surface_friction: Guess


# Household drawers need 2-15 N and dampen a little; the authors of the method use 0.8-1.0 N and 70-80 N s/m for
# every drawer and 20-30 N m s/rad for laptops, never identified. These are wide priors for the gap tools to narrow.
PRISMATIC = Physics(
    frictionloss=Guess(3.0, 0.5, 10.0),
    damping=Guess(20.0, 2.0, 70.0),
    armature=0.02,
    density_kg_m3=Guess(500.0, 200.0, 900.0),
    surface_friction=Guess(0.45, 0.25, 0.7),
)
REVOLUTE = Physics(
    frictionloss=Guess(0.3, 0.05, 1.5),
    damping=Guess(0.2, 0.02, 2.0),
    armature=0.002,
    density_kg_m3=Guess(600.0, 200.0, 1500.0),
    surface_friction=Guess(0.45, 0.25, 0.7),
)


def prior(joint_type: JointType) -> Physics:
    """The prior of a joint type."""
    return PRISMATIC if joint_type == "prismatic" else REVOLUTE
