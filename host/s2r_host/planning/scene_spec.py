"""Arm, object and table put together, as specifications of the coarse and the fine model."""

from __future__ import annotations

import warnings
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.object_names import RIM_PREFIX
from s2r_host.planning.scene_file import SceneFile, read_spec
from s2r_host.planning.settings import PlanSettings, ServoSettings
from s2r_protocol.arms import ArmDescription
from s2r_protocol.arms.source import FINGER_PREFIX

OBJECT_PREFIX = "object/"  # keeps the object's names apart from the arm's

ROBOT_BIT, WORLD_BIT = 1, 2
# Nothing meets it. Without any bit MuJoCo would leave rims out of the boxes by which it looks for pairs.
RIM_BIT = 1 << 28
# A scene keeps its own contact bits but these two; the arm meets everything solid in it through one of them.
SCENE_ROBOT_BIT = 1 << 29
ROBOT_CONTACTS = "robot_contacts"  # the sensor that counts them
# Dry friction that holds what it can hold, in a model stepped by 2 ms; the last two are MuJoCo's own.
FIRM_SOLREF, FIRM_SOLIMP = (0.004, 1.0), (0.99, 0.999, 0.0001, 0.5, 2.0)
# MuJoCo's contact sensor: bits of what it gives, and the reduction to one wrench in the world frame.
_FOUND, _FORCE, _POSITION, _NET_FORCE = 1, 2, 16, 3


def fine_model_spec(
    arm: ArmDescription, object_mjcf: str | Path, joint: str, settings: PlanSettings, given: SceneFile | None
) -> mujoco.MjSpec:
    """Arm and object as the execution model, not compiled."""
    spec = _together(arm, object_mjcf, joint, settings, given, fine=True)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.timestep = settings.fine_timestep_s
    _add_contact_sensors(spec, arm, joint, _FOUND | _FORCE | _POSITION)
    return spec


def coarse_model_spec(
    arm: ArmDescription, object_mjcf: str | Path, joint: str, settings: PlanSettings, given: SceneFile | None
) -> mujoco.MjSpec:
    """Arm and object as the rollout model, not compiled."""
    spec = _together(arm, object_mjcf, joint, settings, given, fine=False)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    _add_clearance(spec, arm, settings.clearance_m)
    _add_sensors(spec, arm, joint)
    return spec


def _together(
    arm: ArmDescription,
    object_mjcf: str | Path,
    joint: str,
    settings: PlanSettings,
    given: SceneFile | None,
    *,
    fine: bool,
) -> mujoco.MjSpec:
    """Arm and object in the arm's base frame, with the contact bits of either convention."""
    spec = _arm_spec(arm, settings.servo)
    # MuJoCo would go on from the reference state, at rest, as if nothing had been: on target, if that is the target.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    if given is None:
        _set_contacts(spec, ROBOT_BIT, WORLD_BIT, fine=fine)
        spec.attach(_object_spec(object_mjcf, joint), prefix=OBJECT_PREFIX, frame=spec.worldbody.add_frame())
        _add_table(spec)
        spec.option.gravity = [0.0, 0.0, -9.81]
    else:
        thing = given.spec.copy()
        _meet_robot(thing)
        priority = max((int(geom.priority) for geom in thing.geoms), default=0)
        _set_contacts(spec, SCENE_ROBOT_BIT, 0, fine=fine, priority=priority + 1)
        X = given.X_base_scene
        quat_wxyz = np.empty(4)
        mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(X[:3, :3]).ravel())
        frame = spec.worldbody.add_frame(pos=X[:3, 3], quat=quat_wxyz)
        _attach_quietly(spec, thing, frame)
        spec.option.gravity = X[:3, :3] @ given.gravity
    if fine:
        for name, tau_max in zip(arm.joint_names, arm.limits.tau_max, strict=True):
            driven = spec.joint(name)
            driven.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            driven.actfrcrange = [-tau_max, tau_max]
    return spec


def _attach_quietly(spec: mujoco.MjSpec, thing: mujoco.MjSpec, frame: mujoco.MjsFrame) -> None:
    """Attach a scene. MuJoCo would warn, and write a log, about options of it that the planner sets itself."""
    for name in ("memory", "njmax", "nconmax", "nkey", "nuserdata"):
        setattr(thing, name, getattr(spec, name))
    looks = [name for name in dir(spec.visual) if not name.startswith("_")]
    groups = [(spec.option, thing.option)]
    groups += [(getattr(spec.visual, name), getattr(thing.visual, name)) for name in looks]
    for ours, theirs in groups:
        for name in dir(ours):
            if not name.startswith("_"):
                setattr(theirs, name, getattr(ours, name))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        spec.attach(thing, prefix=OBJECT_PREFIX, frame=frame)


def _add_table(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[2.0, 2.0, 0.1],
        contype=WORLD_BIT,
        conaffinity=ROBOT_BIT,
    )


def _arm_spec(arm: ArmDescription, servo: ServoSettings) -> mujoco.MjSpec:
    """The arm with position servos and gravity compensation."""
    spec = mujoco.MjSpec.from_string(arm.mjcf)
    for key in list(spec.keys):
        spec.delete(key)
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0
    for geom in spec.geoms:
        geom.friction = [servo.finger_friction, 0.005, 0.0001]
    declared = {frozenset((e.bodyname1, e.bodyname2)) for e in spec.excludes}
    for first, second in arm.collision_exclude:
        if frozenset((first, second)) not in declared:
            spec.add_exclude(bodyname1=first, bodyname2=second)
    for name in arm.joint_names:
        joint = spec.joint(name)
        joint.armature = servo.armature
        joint.damping = [servo.damping, 0.0, 0.0]
        joint.actgravcomp = True
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=servo.kp, kv=servo.kd)
    return spec


def _set_contacts(
    spec: mujoco.MjSpec, robot_bit: int, world_bit: int, *, fine: bool, priority: int = 1
) -> None:
    """Contact bits of the arm's geoms; only the fine model lets the arm meet itself. Its friction decides."""
    for geom in spec.geoms:
        geom.priority = priority
        geom.contype = robot_bit
        geom.conaffinity = world_bit | robot_bit if fine else world_bit


def _object_spec(object_mjcf: str | Path, joint: str) -> mujoco.MjSpec:
    """The object, its geoms set to meet the robot only; visual geoms stay visual."""
    spec = read_spec(object_mjcf, joint)
    for geom in spec.geoms:
        geom.margin = geom.gap = 0.0
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = WORLD_BIT, ROBOT_BIT
        elif geom.name.startswith(RIM_PREFIX):
            geom.contype = RIM_BIT
    for moving in spec.joints:
        _harden_friction(moving)
    return spec


def _harden_friction(joint: mujoco.MjsJoint) -> None:
    """Let dry friction hold what it can hold, unless the file has its own idea.

    As MuJoCo has it by default, a lid under gravity creeps by 0.04 rad/s below its friction: by the time the timed
    motion arrives its edge is a centimetre lower than where the plan found it.
    """
    default_ref, default_imp = [0.02, 1.0], [0.9, 0.95, 0.001, 0.5, 2.0]
    if np.allclose(joint.solref_friction, default_ref) and np.allclose(joint.solimp_friction, default_imp):
        joint.solref_friction, joint.solimp_friction = [*FIRM_SOLREF], [*FIRM_SOLIMP]


def _meet_robot(scene: mujoco.MjSpec) -> None:
    """Let every solid geom of a scene meet the robot, and each other as before."""
    for geom in scene.geoms:
        geom.margin = geom.gap = 0.0
        if geom.contype or geom.conaffinity:
            geom.contype &= ~(SCENE_ROBOT_BIT | RIM_BIT)
            geom.conaffinity = (geom.conaffinity | SCENE_ROBOT_BIT) & ~RIM_BIT
        elif geom.name.startswith(RIM_PREFIX):
            geom.contype = RIM_BIT


def _add_clearance(spec: mujoco.MjSpec, arm: ArmDescription, clearance_m: float) -> None:
    """Let near misses of the robot, except the fingertip, count as contacts, without any force."""
    robot = {shape.name for shape in arm.source.shapes}
    for geom in spec.geoms:
        if geom.name in robot and not geom.name.startswith(FINGER_PREFIX):
            geom.margin = geom.gap = clearance_m


def _add_sensors(spec: mujoco.MjSpec, arm: ArmDescription, joint: str) -> None:
    """Tool pose in the part's frame (3 + 4 numbers), then contacts: the robot's (1), per finger count and force."""
    part = spec.joint(OBJECT_PREFIX + joint).parent.name
    for kind in (mujoco.mjtSensor.mjSENS_FRAMEPOS, mujoco.mjtSensor.mjSENS_FRAMEQUAT):
        spec.add_sensor(
            name=kind.name,
            type=kind,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=arm.tool_frame,
            reftype=mujoco.mjtObj.mjOBJ_XBODY,
            refname=part,
        )
    _add_contact_sensors(spec, arm, joint, _FOUND | _FORCE)


def _add_contact_sensors(spec: mujoco.MjSpec, arm: ArmDescription, joint: str, finger: int) -> None:
    """The robot's contacts (1 number), and per finger shape what ``finger`` asks about its contacts with the part."""
    part = spec.joint(OBJECT_PREFIX + joint).parent.name
    # All contacts of the robot; a scene has others, among its own things.
    spec.add_sensor(
        name=ROBOT_CONTACTS,
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=arm.source.base,
        intprm=[_FOUND, 0, 1],
    )
    for geom in spec.geoms:
        if geom.name.startswith(FINGER_PREFIX):
            spec.add_sensor(
                name=f"touch_{geom.name}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_GEOM,
                objname=geom.name,
                reftype=mujoco.mjtObj.mjOBJ_XBODY,
                refname=part,
                intprm=[finger, _NET_FORCE, 1],  # one slot
            )
