"""The seven-joint arm the project ships, with Pinocchio's articulated-body algorithms for the equations of motion.

Featherstone, Rigid Body Dynamics Algorithms, 2008 (composite rigid body and recursive Newton-Euler), as
implemented by Pinocchio.  Kinematics and gripper are fixed; link masses, motor inertia and friction are drawn.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cached_property
from typing import ClassVar

import numpy as np
import pinocchio as pin

from s2r_conceal import mjcf
from s2r_conceal.parameters import STANDARD_GRAVITY, Machine
from s2r_conceal.rigs.base import Dynamics, Rig
from s2r_protocol.arms import load_arm

CLEAR_RAD = 0.1


class _Chain(Dynamics):
    refresh_every = 5  # 2 kHz, linear in between

    def __init__(self, models: list[pin.Model]) -> None:
        self._models = models
        self._datas = [model.createData() for model in models]

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        mass = np.empty((len(q), q.shape[1], q.shape[1]))
        for k in range(len(q)):
            model, data = self._models[k % len(self._models)], self._datas[k % len(self._models)]
            mass[k] = pin.crba(model, data, q[k])
        upper = np.triu(mass)
        return upper + np.swapaxes(np.triu(mass, 1), 1, 2)

    def bias(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        out = np.empty_like(q)
        for k in range(len(q)):
            model, data = self._models[k % len(self._models)], self._datas[k % len(self._models)]
            out[k] = pin.nonLinearEffects(model, data, q[k], dq[k])
        return out


class SevenJoint(Rig):
    """The shipped arm with drawn deviations of its links and drawn motors."""

    name = "seven_joint"
    joint_names: ClassVar[tuple[str, ...]] = tuple(f"joint{i}" for i in range(1, 8))

    @cached_property
    def _arm(self):  # noqa: ANN202 - ArmDescription; the name would import numerics at annotation time
        return load_arm("xmate3pro")

    @cached_property
    def _links(self) -> Machine:
        """Link inertias as the shipped model file has them, gripper not included."""
        root = ET.fromstring(self._arm.mjcf)
        found = [root.find(f".//body[@name='link{i}']/inertial") for i in range(1, 8)]
        entries = [e.attrib for e in found if e is not None]
        zeros = np.zeros(7)
        return Machine(
            mass=np.array([float(e["mass"]) for e in entries]),
            com=np.array([[float(x) for x in e["pos"].split()] for e in entries]),
            inertia=np.array([np.diag([float(x) for x in e["diaginertia"].split()]) for e in entries]),
            armature=zeros,
            viscous=zeros,
            coulomb=zeros,
            gravity=np.array([0.0, 0.0, -STANDARD_GRAVITY]),
        )

    def draw(self, rng: np.random.Generator) -> Machine:
        """A drawn machine of this kind."""
        links = self._links
        weight = np.array([20.0, 40.0, 15.0, 20.0, 6.0, 6.0, 3.0])  # torque scale per joint [N·m]
        return Machine(
            mass=links.mass * rng.uniform(0.9, 1.1, 7),
            com=links.com * rng.uniform(0.9, 1.1, (7, 1)),
            inertia=links.inertia * rng.uniform(0.9, 1.1, (7, 1, 1)),
            armature=np.array([0.5, 0.5, 0.35, 0.35, 0.12, 0.12, 0.06]) * rng.uniform(0.7, 1.3, 7),
            viscous=weight * rng.uniform(0.02, 0.1, 7),
            coulomb=weight * rng.uniform(0.02, 0.08, 7),
            gravity=links.gravity,
        )

    def dynamics(self, machines: list[Machine]) -> Dynamics:
        """Equations of motion, one column per machine."""
        return _Chain([self._model(machine) for machine in machines])

    def _model(self, machine: Machine) -> pin.Model:
        model = pin.buildModelFromXML(self._arm.urdf)
        nominal = self._links
        for i in range(7):
            # link7 carries the gripper as one fixed body: exchange the link's own share only
            share = pin.Inertia(float(nominal.mass[i]), nominal.com[i], nominal.inertia[i])
            rest = model.inertias[i + 1] - share if i == 6 else None
            own = pin.Inertia(float(machine.mass[i]), machine.com[i], machine.inertia[i])
            model.inertias[i + 1] = own if rest is None else own + rest
        model.gravity.linear = machine.gravity
        return model

    def tip(self, machine: Machine) -> np.ndarray:
        """Where a payload sits in the last link's frame [m]."""
        return np.array([0.0, 0.0, 0.22])

    def stroke(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Centre and half-width of the motion [rad]."""
        centre = self._arm.q_home + rng.uniform(-0.15, 0.15, 7)
        half = np.array([0.8, 0.5, 0.8, 0.6, 0.9, 0.7, 1.2]) * rng.uniform(0.7, 1.0, 7)
        limits = self._arm.limits  # the equations of motion know no end stops; the motion keeps clear of them
        return np.clip(centre, limits.q_min + half + CLEAR_RAD, limits.q_max - half - CLEAR_RAD), half

    def mjcf(self, machine: Machine, joint_attributes: list[dict[str, str]]) -> str:
        """The model file."""
        root = ET.fromstring(self._arm.mjcf)
        for tag in ("keyframe", "contact"):
            for element in root.findall(tag):
                root.remove(element)
        option = root.find("option")
        if option is None:
            option = ET.Element("option")
            root.insert(1, option)
        option.attrib.update(
            timestep="0.001", integrator="implicitfast", gravity=mjcf.numbers(machine.gravity)
        )
        for geom in root.iter("geom"):
            geom.attrib.update(contype="0", conaffinity="0", mass="0")
        for i, name in enumerate(self.joint_names):
            body = root.find(f".//body[@name='link{i + 1}']")
            joint = root.find(f".//joint[@name='{name}']")
            if body is None or joint is None:
                raise RuntimeError(f"the shipped model has no link{i + 1} with {name}")
            old = body.find("inertial")
            if old is not None:
                body.remove(old)
            mjcf.inertial(body, float(machine.mass[i]), machine.com[i], machine.inertia[i])
            joint.attrib.update(mjcf.joint_attributes_of(machine, i) | joint_attributes[i])
        mjcf.motors(root, list(self.joint_names))
        return mjcf.document(root)
