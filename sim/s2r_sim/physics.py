"""Arm, object and table in MuJoCo, stepped one millisecond at a time under joint torques."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_protocol.arms import ArmDescription
from s2r_sim.errors import WorldFileError
from s2r_sim.objects.catalogue import add_object, states_as_found
from s2r_sim.objects.effects import JointEffects
from s2r_sim.objects.naming import BASE_BODY, FAR_BODY, JOINT, PART_BODY
from s2r_sim.objects.scene import add_table
from s2r_sim.stability import StabilityWatch
from s2r_sim.world import ArmTruth, WorldSpec

STEP_NS = 1_000_000
FINGER_FRICTION = 0.6
# Rotor inertia times gear ratio squared [kg·m²]: large with harmonic gears; it keeps a stiff drive loop calm.
ROTOR_INERTIA_BIG = 0.6
ROTOR_INERTIA_WRIST = 0.15
# Of the gear's own, output side [kg·m²]: one of 1e4 N·m/rad then swings slowly enough for the step whatever is on it.
GEAR_INERTIA = 0.003
WRIST_TORQUE_Nm = 50.0  # joints with a lower torque limit count as wrist joints


def rotor_inertia(arm: ArmDescription) -> np.ndarray:
    """Reflected rotor inertia per joint [kg·m²], shape (dof,)."""
    return np.where(arm.limits.tau_max < WRIST_TORQUE_Nm, ROTOR_INERTIA_WRIST, ROTOR_INERTIA_BIG)


def nominal_arm(arm: ArmDescription) -> mujoco.MjModel:
    """The arm as described, alone: what a drive's gravity compensation knows."""
    return mujoco.MjSpec.from_string(arm.mjcf).compile()


def build_world(arm: ArmDescription, world: WorldSpec) -> mujoco.MjModel:
    """The hidden world as a MuJoCo model. The camera process builds the same one.

    Raises:
        WorldFileError: It does not fit the arm, or says something impossible.
    """
    spec = mujoco.MjSpec.from_string(arm.mjcf)
    spec.modelname = "stand-in"
    option = spec.option
    option.timestep = STEP_NS * 1e-9
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    spec.memory = 8 * 1024 * 1024
    _make_true(spec, arm, world.arm)
    add_table(spec)
    add_object(spec, world.object)
    try:
        return spec.compile()
    except ValueError as error:  # names the element: a size below 0, a mass that is left over from none
        raise WorldFileError(f"MuJoCo takes no such world: {'; '.join(str(error).splitlines())}") from error


def _make_true(spec: mujoco.MjSpec, arm: ArmDescription, truth: ArmTruth) -> None:
    dof, gears = arm.dof, truth.gears
    entries = truth.model_dump(exclude={"gears"})
    if gears is not None:
        entries["gears.stiffness_Nm_rad"] = gears.stiffness_Nm_rad
    for name, values in entries.items():
        if len(values) != dof:
            raise WorldFileError(f"arm.{name} has {len(values)} entries, arm {arm.name} has {dof} joints")
    inertia = rotor_inertia(arm)
    for i, joint in enumerate(arm.source.joints):
        mj_joint = spec.joint(joint.name)
        mj_joint.frictionloss = truth.coulomb_Nm[i]
        mj_joint.damping = [truth.viscous_Nms_rad[i], 0, 0]
        mj_joint.armature = float(inertia[i])
        link = spec.body(joint.child)
        if gears is not None:
            _add_gear(link, mj_joint, gears.stiffness_Nm_rad[i], gears.relaxation_s)
        link.mass *= truth.link_mass_scale[i]
        link.inertia = np.asarray(link.inertia) * truth.link_mass_scale[i]
    for geom in spec.geoms:
        if geom.name.startswith("finger"):
            geom.friction = [FINGER_FRICTION, 0.005, 0.0001]


def _gear(joint: str) -> str:
    """Name of the spring between motor and link of a joint."""
    return f"{joint}_gear"


def _add_gear(
    link: mujoco.MjsBody, motor: mujoco.MjsJoint, stiffness_Nm_rad: float, relaxation_s: float
) -> None:
    """A second joint along the motor's: rotor, friction and drive stay with the motor, the link turns by both."""
    link.add_joint(
        name=_gear(motor.name),
        type=motor.type,
        pos=motor.pos,
        axis=motor.axis,
        stiffness=[stiffness_Nm_rad, 0, 0],
        damping=[relaxation_s * stiffness_Nm_rad, 0, 0],
        armature=GEAR_INERTIA,
    )


@dataclass(frozen=True)
class Contacts:
    """Whether any part of the arm touches something, and how hard [N] it presses on the moving part."""

    part: bool
    base: bool
    table: bool
    part_force_N: float


class Physics:
    """The world's state. All arm arrays have shape (dof,) in the arm's joint order."""

    def __init__(self, arm: ArmDescription, world: WorldSpec) -> None:
        self.arm = arm
        self.model = build_world(arm, world)
        self.data = mujoco.MjData(self.model)
        self.dof = arm.dof
        self._stability = StabilityWatch(self.data)
        self._q_index = np.array([self.model.joint(name).qposadr[0] for name in arm.joint_names])
        self._v_index = np.array([self.model.joint(name).dofadr[0] for name in arm.joint_names])
        elastic = world.arm.gears is not None
        gears = [self.model.joint(_gear(name)).qposadr[0] for name in arm.joint_names] if elastic else []
        self._gear_index = np.array(gears, dtype=int)
        self._object_q = int(self.model.joint(JOINT).qposadr[0])
        self._object_v = int(self.model.joint(JOINT).dofadr[0])
        self._effects = None if world.effects.none else world.effects
        self._coulomb = float(self.model.dof_frictionloss[self._object_v])
        self._side = self._geom_sides()
        self.data.qpos[self._q_index] = arm.q_home
        for name, value in states_as_found(world.object).items():
            self.data.joint(name).qpos[0] = value
        others = list(states_as_found(world.object))[1:]
        self._others_q = np.array([self.model.joint(name).qposadr[0] for name in others], dtype=int)
        mujoco.mj_forward(self.model, self.data)
        self._refuse_collision_at_start()
        self._nominal = nominal_arm(arm)
        self._nominal_data = mujoco.MjData(self._nominal)
        self._torque = np.zeros(self._nominal.nv)
        self._rotor = rotor_inertia(arm)

    def _geom_sides(self) -> np.ndarray:
        """Per geom: 1 arm, 2 moving part, 3 object base, 4 anything else (the table)."""
        roots = {PART_BODY: 2, FAR_BODY: 2, BASE_BODY: 3}
        sides = np.full(self.model.ngeom, 4)
        arm_bodies = {self.arm.source.base, *(joint.child for joint in self.arm.source.joints)}
        arm_bodies |= {mount.child for mount in self.arm.source.mounts}
        for geom in range(self.model.ngeom):
            name = self.model.body(self.model.geom_bodyid[geom]).name
            # Another part that moves is the object's as its base is: touching it is not touching the part.
            other = 3 if name.startswith(f"{PART_BODY}_") else 4
            sides[geom] = 1 if name in arm_bodies else roots.get(name, other)
        return sides

    def _refuse_collision_at_start(self) -> None:
        contacts = self.contacts()
        if contacts.part or contacts.base:
            raise WorldFileError(
                "the object stands where the arm is in its home pose; move it (its x and y in the world file)"
            )

    @property
    def q(self) -> list[float]:
        """Joint positions at the motors, where the encoders are [rad]."""
        return self.data.qpos[self._q_index].tolist()

    @property
    def q_link(self) -> list[float]:
        """Joint positions of the links [rad]: those of the motors, and what the gears give."""
        if not self._gear_index.size:
            return self.q
        return (self.data.qpos[self._q_index] + self.data.qpos[self._gear_index]).tolist()

    @property
    def dq(self) -> list[float]:
        """Joint velocities at the motors [rad/s]."""
        return self.data.qvel[self._v_index].tolist()

    @property
    def object_value(self) -> float:
        """True coordinate of the object's joint [m or rad]."""
        return float(self.data.qpos[self._object_q])

    @property
    def other_values(self) -> list[float]:
        """True coordinates of the other parts that move [m or rad]."""
        return self.data.qpos[self._others_q].tolist()

    def nominal_torque(self, q: list[float], dq: list[float], ddq: list[float]) -> list[float]:
        """Torques that move the arm as described [N·m], rotors included: the feed-forward of its drives."""
        model, data = self._nominal, self._nominal_data
        data.qpos[:] = q
        data.qvel[:] = dq
        data.qacc[:] = ddq
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, self._torque)
        return (self._torque + self._rotor * data.qacc).tolist()

    def step(self, tau: list[float]) -> None:
        """Advance by one step under joint torques [N·m].

        Raises:
            UnstableError: The world cannot be simulated any further.
        """
        self.data.qfrc_applied[self._v_index] = tau
        if self._effects is not None:
            self._apply(self._effects)
        mujoco.mj_step(self.model, self.data)
        self._stability.check()

    def _apply(self, effects: JointEffects) -> None:
        s, v = float(self.data.qpos[self._object_q]), float(self.data.qvel[self._object_v])
        self.model.dof_frictionloss[self._object_v] = effects.friction(self._coulomb, s, v)
        self.data.qfrc_applied[self._object_v] = effects.force(s)

    def contacts(self) -> Contacts:
        """What the arm touches now."""
        force = np.zeros(6)
        touched, pressed = set(), 0.0
        for i in range(self.data.ncon):
            sides = sorted(self._side[g] for g in self.data.contact[i].geom)
            if sides[0] != 1 or sides[1] == 1 or self.data.contact[i].efc_address < 0:
                continue
            touched.add(int(sides[1]))
            if sides[1] == 2:
                mujoco.mj_contactForce(self.model, self.data, i, force)
                pressed += float(force[0])
        return Contacts(2 in touched, 3 in touched, 4 in touched, pressed)
