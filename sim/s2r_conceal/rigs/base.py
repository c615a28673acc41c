"""What a rig has to offer: kinematics fixed, masses drawn, equations of motion for many columns at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from s2r_conceal.errors import DrawError
from s2r_conceal.parameters import Machine


class Dynamics(ABC):
    """Equations of motion ``M(q) ddq + bias(q, dq) = tau`` of many machines of one rig, side by side.

    Attributes:
        refresh_every: Integrator steps between two evaluations; in between M and bias are extrapolated
            linearly, which is exact to second order in the step.
    """

    refresh_every: ClassVar[int] = 1

    @abstractmethod
    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """Rigid-body inertia without armature, shape (columns, joints, joints), for q (columns, joints)."""

    @abstractmethod
    def bias(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Coriolis, centrifugal and gravity torque, shape (columns, joints)."""


class Rig(ABC):
    """One kind of machine."""

    name: ClassVar[str]
    joint_names: ClassVar[tuple[str, ...]]

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Machine:
        """A machine of this kind; friction and armature included."""

    @abstractmethod
    def dynamics(self, machines: list[Machine]) -> Dynamics:
        """Equations of motion of these machines, one column each."""

    def inverse_dynamics(
        self, machine: Machine, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> np.ndarray:
        """Torque of a given motion without friction [N·m]; all arrays (ticks, joints), one machine."""
        dynamics = self.dynamics([machine])
        rigid = np.einsum(
            "tij,tj->ti", np.broadcast_to(dynamics.mass_matrix(q), (len(q), *[self.joints] * 2)), ddq
        )
        return rigid + machine.armature * ddq + dynamics.bias(q, dq)

    @abstractmethod
    def tip(self, machine: Machine) -> np.ndarray:
        """Where a payload would sit in the last link's frame [m], shape (3,)."""

    @abstractmethod
    def stroke(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Centre and half-width of the motion [rad], each shape (joints,)."""

    @abstractmethod
    def mjcf(self, machine: Machine, joint_attributes: list[dict[str, str]]) -> str:
        """The model file: bodies of ``machine`` and, per joint, further MJCF attributes."""


def rig_named(name: str) -> Rig:
    """The rig of that name.

    Raises:
        DrawError: There is none.
    """
    from s2r_conceal.rigs.one_joint import OneJoint
    from s2r_conceal.rigs.seven_joint import SevenJoint
    from s2r_conceal.rigs.two_link import TwoLink

    rigs: dict[str, type[Rig]] = {rig.name: rig for rig in (OneJoint, TwoLink, SevenJoint)}
    if name not in rigs:
        raise DrawError(f"unknown rig '{name}'; there are {', '.join(rigs)}")
    return rigs[name]()
