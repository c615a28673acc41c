"""One hinge about the world's +y axis, loaded by gravity: a physical pendulum with a motor.

With the centre of mass at (cx, 0, cz) in the link frame, world position after turning by q is
(cx cos q + cz sin q, 0, −cx sin q + cz cos q), so with gravity (gx, 0, gz)

    (Iyy + m (cx² + cz²)) ddq = tau + m [gx (−cx sin q + cz cos q) + gz (−cx cos q − cz sin q)].

Source: Lagrange's equation for one coordinate, e.g. Goldstein, Classical Mechanics, 3rd ed., section 1.4.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from s2r_conceal.mjcf import Link, chain
from s2r_conceal.parameters import STANDARD_GRAVITY, Machine
from s2r_conceal.rigs.base import Dynamics, Rig


class _Pendulum(Dynamics):
    def __init__(self, machines: list[Machine]) -> None:
        mass = np.array([m.mass[0] for m in machines])
        com = np.array([m.com[0] for m in machines])
        gravity = np.array([m.gravity for m in machines])
        about_com = np.array([m.inertia[0, 1, 1] for m in machines])
        self._inertia = (about_com + mass * (com[:, 0] ** 2 + com[:, 2] ** 2))[:, None, None]
        gx, gz = gravity[:, 0], gravity[:, 2]
        self._sin = (mass * (gx * com[:, 0] + gz * com[:, 2]))[:, None]
        self._cos = (mass * (gz * com[:, 0] - gx * com[:, 2]))[:, None]

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        return self._inertia

    def bias(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        return self._sin * np.sin(q) + self._cos * np.cos(q)


class OneJoint(Rig):
    """A gravity-loaded joint of 1 to 6 kg on 0.12 to 0.45 m."""

    name = "one_joint"
    joint_names: ClassVar[tuple[str, ...]] = ("joint1",)

    def draw(self, rng: np.random.Generator) -> Machine:
        """A drawn machine of this kind."""
        mass = rng.uniform(1.0, 6.0)
        length = rng.uniform(0.12, 0.45)
        bearing = rng.uniform(-np.pi, np.pi)
        com = length * np.array([[np.cos(bearing), 0.0, np.sin(bearing)]])
        gyration = length * rng.uniform(0.25, 0.6)
        about_com = mass * gyration**2
        link_inertia = about_com + mass * length**2
        weight = mass * STANDARD_GRAVITY * length
        return Machine(
            mass=np.array([mass]),
            com=com,
            inertia=np.diag([about_com, about_com, 0.6 * about_com])[None],
            armature=np.array([link_inertia * rng.uniform(0.15, 0.6)]),
            viscous=np.array([weight * rng.uniform(0.005, 0.04)]),
            coulomb=np.array([weight * rng.uniform(0.01, 0.06)]),
            gravity=np.array([0.0, 0.0, -STANDARD_GRAVITY]),
        )

    def dynamics(self, machines: list[Machine]) -> Dynamics:
        """Equations of motion, one column per machine."""
        return _Pendulum(machines)

    def tip(self, machine: Machine) -> np.ndarray:
        """Where a payload sits in the last link's frame [m]."""
        return 1.3 * machine.com[0]

    def stroke(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Centre and half-width of the motion [rad]."""
        return np.array([rng.uniform(-0.6, 0.6)]), np.array([rng.uniform(0.7, 1.4)])

    def mjcf(self, machine: Machine, joint_attributes: list[dict[str, str]]) -> str:
        """The model file."""
        link = Link("link1", "joint1", (0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
        return chain([link], machine, joint_attributes)
