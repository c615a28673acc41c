"""Two hinges about +y in a vertical plane, the second at the end of the first link.

With d the offset between the hinges and c the second centre of mass, both as vectors in the plane,
R(q) the rotation about y and q12 = q1 + q2, the textbook planar arm is (Siciliano et al., Robotics:
Modelling, Planning and Control, section 7.3.2, with masses off the link axes)

    M11 = I1 + m1 |c1|² + I2 + m2 (|d|² + |c2|² + 2 a),  M12 = I2 + m2 (|c2|² + a),  M22 = I2 + m2 |c2|²
    a = d · R(q2) c2,   a' = da/dq2,   C = [m2 a' (2 dq1 dq2 + dq2²),  −m2 a' dq1²].
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from s2r_conceal.mjcf import Link, chain
from s2r_conceal.parameters import STANDARD_GRAVITY, Machine
from s2r_conceal.rigs.base import Dynamics, Rig

UPPER_M = 0.35  # distance between the hinges, along the first link's +x


class _Planar(Dynamics):
    def __init__(self, machines: list[Machine]) -> None:
        self._m = np.array([m.mass for m in machines])
        com = np.array([m.com for m in machines])
        self._x, self._z = com[:, :, 0], com[:, :, 2]
        about = np.array([m.inertia[:, 1, 1] for m in machines])
        self._own = about + self._m * (self._x**2 + self._z**2)
        gravity = np.array([m.gravity for m in machines])
        self._gx, self._gz = gravity[:, 0], gravity[:, 2]

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        m2 = self._m[:, 1]
        reach = UPPER_M * (self._x[:, 1] * np.cos(q[:, 1]) + self._z[:, 1] * np.sin(q[:, 1]))
        m22 = np.broadcast_to(self._own[:, 1], reach.shape)
        m12 = m22 + m2 * reach
        m11 = self._own[:, 0] + m22 + m2 * (UPPER_M**2 + 2.0 * reach)
        return np.stack([np.stack([m11, m12], -1), np.stack([m12, m22], -1)], -2)

    def bias(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        m1, m2 = self._m[:, 0], self._m[:, 1]
        slope = UPPER_M * (-self._x[:, 1] * np.sin(q[:, 1]) + self._z[:, 1] * np.cos(q[:, 1]))
        both = q[:, 0] + q[:, 1]
        weight1 = self._moment(m1 * self._x[:, 0] + m2 * UPPER_M, m1 * self._z[:, 0], q[:, 0])
        weight2 = self._moment(m2 * self._x[:, 1], m2 * self._z[:, 1], both)
        first = m2 * slope * (2.0 * dq[:, 0] * dq[:, 1] + dq[:, 1] ** 2) + weight1 + weight2
        return np.stack([first, -m2 * slope * dq[:, 0] ** 2 + weight2], -1)

    def _moment(self, mx: np.ndarray, mz: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Torque needed against gravity by a first moment (mx, mz) turned by ``angle`` about y."""
        sin, cos = np.sin(angle), np.cos(angle)
        return -(self._gx * (-mx * sin + mz * cos) + self._gz * (-mx * cos - mz * sin))


class TwoLink(Rig):
    """A planar arm of two links, 2 to 5 kg and 1 to 3 kg."""

    name = "two_link"
    joint_names: ClassVar[tuple[str, ...]] = ("joint1", "joint2")

    def draw(self, rng: np.random.Generator) -> Machine:
        """A drawn machine of this kind."""
        mass = np.array([rng.uniform(2.0, 5.0), rng.uniform(1.0, 3.0)])
        length = np.array([rng.uniform(0.12, 0.25), rng.uniform(0.1, 0.25)])
        com = np.stack([length, np.zeros(2), length * rng.uniform(-0.15, 0.15, 2)], axis=1)
        about = mass * (0.4 * length) ** 2
        inertia = np.stack([np.diag([0.3 * a, a, a]) for a in about])
        seen = np.array([mass[0] * length[0] ** 2 + mass[1] * UPPER_M**2, mass[1] * length[1] ** 2])
        weight = STANDARD_GRAVITY * np.array(
            [mass[0] * length[0] + mass[1] * (UPPER_M + length[1]), mass[1] * length[1]]
        )
        return Machine(
            mass=mass,
            com=com,
            inertia=inertia,
            armature=seen * rng.uniform(0.15, 0.6, 2),
            viscous=weight * rng.uniform(0.005, 0.04, 2),
            coulomb=weight * rng.uniform(0.01, 0.06, 2),
            gravity=np.array([0.0, 0.0, -STANDARD_GRAVITY]),
        )

    def dynamics(self, machines: list[Machine]) -> Dynamics:
        """Equations of motion, one column per machine."""
        return _Planar(machines)

    def tip(self, machine: Machine) -> np.ndarray:
        """Where a payload sits in the last link's frame [m]."""
        return 1.5 * machine.com[1]

    def stroke(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Centre and half-width of the motion [rad]."""
        return rng.uniform(-0.5, 0.5, 2), rng.uniform(0.6, 1.2, 2)

    def mjcf(self, machine: Machine, joint_attributes: list[dict[str, str]]) -> str:
        """The model file."""
        y = (0.0, 1.0, 0.0)
        links = [
            Link("link1", "joint1", y, (0.0, 0.0, 0.0)),
            Link("link2", "joint2", y, (UPPER_M, 0.0, 0.0)),
        ]
        return chain(links, machine, joint_attributes)
