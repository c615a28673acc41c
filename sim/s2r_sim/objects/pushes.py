"""Pushes with a flying fingertip: which places and directions move the part of an object, and by how much.

The finger is the gripper's closed fingertip without the arm, drawn along its own axis by springs of limited
force. What the arm cannot do (reach, the wrist's room) is left to its planner; what the object does is the
same.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_sim.objects.catalogue import KINDS, ObjectSpec
from s2r_sim.objects.naming import JOINT
from s2r_sim.objects.scene import qpos_at, table_scene

TIP_RADIUS_M = 0.0075
FINGER_M = 0.10
STANDOFF_M = 0.04
TRAVEL_M = 0.08  # past the first contact
SPEED = 0.15  # m/s
FORCE_N = 40.0
USEFUL_M, USEFUL_RAD = 0.03, np.deg2rad(15)
_STIFFNESS, _DAMPING, _MASS_KG = 3000.0, 90.0, 0.4
_AXES = ("finger_x", "finger_y", "finger_z")


@dataclass(frozen=True)
class PushResult:
    """What a push did.

    Attributes:
        delta: Motion of the joint [m or rad].
        blocked: The finger touched something before it began.
    """

    delta: float
    blocked: bool


def useful(kind: str, delta: float) -> bool:
    """Whether a motion tells enough about the joint: 3 cm or 15 degrees, in either sense."""
    return bool(abs(delta) >= (USEFUL_M if KINDS[kind].slides else USEFUL_RAD))


class PushScene:
    """One object with a flying finger."""

    def __init__(self, spec: ObjectSpec) -> None:
        scene = table_scene(spec)
        scene.option.timestep = 0.002
        scene.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        _add_finger(scene)
        self.model = scene.compile()
        self.data = mujoco.MjData(self.model)
        self._start = qpos_at(self.model, spec.q_start)
        self._joint = int(self.model.joint(JOINT).qposadr[0])
        self._finger = np.array([self.model.joint(name).qposadr[0] for name in _AXES])
        self._mocap = self.model.body("finger_aim").id
        self._finger_geom = self.model.geom("finger").id
        # The finger is turned in its body for every push; MuJoCo else takes its frame for the inertia's.
        self.model.geom_sameframe[self._finger_geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE

    def push(
        self,
        p_contact: np.ndarray,
        direction: np.ndarray,
        travel_m: float = TRAVEL_M,
        axis: np.ndarray | None = None,
    ) -> PushResult:
        """Push from the state as found.

        Args:
            p_contact: Surface point that the fingertip touches first [m], world frame, (3,).
            direction: Unit direction of the push, (3,).
            travel_m: Way past the first touch.
            axis: Unit vector along the finger, towards its tip, (3,); it points along the push if None.
        """
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[:] = self._start
        axis = direction if axis is None else axis
        across = axis - (axis @ direction) * direction
        start = p_contact - (STANDOFF_M + TIP_RADIUS_M) * direction - TIP_RADIUS_M * across
        quat, back, leaned, lean = np.empty(4), np.empty(4), np.empty(3), np.empty(4)
        mujoco.mju_quatZ2Vec(quat, direction)
        model.body_pos[self._mocap], model.body_quat[self._mocap] = start, quat
        mujoco.mju_negQuat(back, quat)
        mujoco.mju_rotVecQuat(leaned, axis, back)
        mujoco.mju_quatZ2Vec(lean, leaned)
        model.geom_pos[self._finger_geom], model.geom_quat[self._finger_geom] = -FINGER_M / 2 * leaned, lean
        mujoco.mj_forward(model, data)
        if any(self._finger_geom in contact.geom for contact in data.contact):
            return PushResult(0.0, blocked=True)
        seconds = (STANDOFF_M + travel_m) / SPEED
        for k in range(int(seconds / model.opt.timestep)):
            data.ctrl[2] = SPEED * k * model.opt.timestep
            mujoco.mj_step(model, data)
        return PushResult(float(data.qpos[self._joint] - self._start[self._joint]), blocked=False)


def _add_finger(scene: mujoco.MjSpec) -> None:
    """A capsule on three springs in a frame whose z axis is the push; the frame is placed anew for every push."""
    aim = scene.worldbody.add_body(name="finger_aim")
    finger = aim.add_body(name="finger", gravcomp=1.0)
    for name, axis in zip(_AXES, np.eye(3), strict=True):
        finger.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    finger.add_geom(
        name="finger",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        pos=[0, 0, -FINGER_M / 2],
        size=[TIP_RADIUS_M, FINGER_M / 2, 0],
        mass=_MASS_KG,
        friction=[0.6, 0.005, 0.0001],
    )
    for name in _AXES:
        actuator = scene.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=_STIFFNESS, kv=_DAMPING)
        actuator.forcelimited = True
        actuator.forcerange = [-FORCE_N, FORCE_N]
