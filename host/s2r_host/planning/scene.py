"""Two models from one belief: arm and object in a coarse model for rollouts and a fine one for execution.

Both come from the same arm description and the same object file, so they have the same joints in the same
order: first the arm's, then the object's. The coarse model trades contact detail for speed; nothing is
delivered that only the coarse model has seen.
"""

from __future__ import annotations

import copy
import enum
import warnings
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.planning.scene_file import SceneFile, SceneFileError, one_line, read_scene, read_spec
from s2r_host.planning.settings import PlanSettings, ServoSettings, Stage
from s2r_protocol.arms import ArmDescription

OBJECT_PREFIX = "object/"  # keeps the object's names apart from the arm's
FINGER_PREFIX = "finger"  # shapes of the tool that are meant to touch the part

_ROBOT_BIT, _WORLD_BIT = 1, 2
# A scene keeps its own contact bits; the arm meets everything solid in it through one bit that scenes leave free.
SCENE_ROBOT_BIT = 1 << 29
_ROBOT_CONTACTS = "robot_contacts"
# MuJoCo's contact sensor: bits of what it gives, and the reduction to one wrench in the world frame.
_FOUND, _FORCE, _POSITION, _NET_FORCE = 1, 2, 16, 3


class GeomKind(enum.IntEnum):
    """What a geom belongs to, as far as contacts are concerned."""

    WORLD = 0  # table, static parts of the object, parts that are not the task's
    PART = 1  # the part that is to be moved
    ROBOT = 2  # links, gripper
    FINGER = 3  # the shapes of the tool that may touch the part


@dataclass(frozen=True, eq=False)
class Scene:
    """Arm, object and table, compiled twice.

    Attributes:
        coarse: Rollout model; its time step is set by :meth:`rollout_model`.
        fine: Execution model.
        arm: The arm description both were made from.
        joint: Name of the object's joint, as in the object file.
        prismatic: True for a slide (s in m), False for a hinge (s in rad).
        s_range: Lower and upper limit of the joint, or None when it has none.
        s_qpos: Index of s in ``qpos``; the arm's joints are ``qpos[:dof]``.
        s_dof: Index of its speed in ``qvel``.
        part_body: Body that the joint moves.
        tool_site: Site of the fingertip.
        geom_kind: GeomKind of every geom, (ngeom,).
        solid: Geoms that the robot can touch, bool (ngeom,).
        on_table: The world frame's plane z = 0 is a table that the planner has added.
        gravity: In the arm's base frame [m/s²], (3,).
        bystanders: Something besides the arm and the task's joint can move.
        X_scene_base: Pose of the arm's base in the file's frame, (4, 4).
        fine_contacts: Address of the fine model's contact sensors: the robot's contacts, then 7 numbers per finger
            shape: contacts with the part, their net force [N] and its point [m] in the world frame.
    """

    coarse: mujoco.MjModel
    fine: mujoco.MjModel
    arm: ArmDescription
    joint: str
    prismatic: bool
    s_range: tuple[float, float] | None
    s_qpos: int
    s_dof: int
    part_body: int
    tool_site: int
    geom_kind: np.ndarray
    solid: np.ndarray
    on_table: bool
    gravity: np.ndarray
    bystanders: bool
    X_scene_base: np.ndarray
    fine_contacts: int

    @property
    def joint_name(self) -> str:
        """The object's joint as it is called in the two models."""
        return OBJECT_PREFIX + self.joint

    @property
    def joint_id(self) -> int:
        """Its index in both."""
        return int(self.fine.joint(self.joint_name).id)

    @property
    def dof(self) -> int:
        """Number of the arm's joints."""
        return self.arm.dof

    def rollout_model(self, stage: Stage) -> mujoco.MjModel:
        """The coarse model at a stage's time step, with or without the arm's collisions with itself."""
        model = copy.copy(self.coarse)
        model.opt.timestep = stage.timestep_s
        if stage.self_collision:
            robot = self.geom_kind >= GeomKind.ROBOT
            model.geom_conaffinity[robot] |= model.geom_contype[robot]
        return model

    def without_robot(self) -> mujoco.MjModel:
        """The fine model with an arm that touches nothing."""
        model = copy.copy(self.fine)
        robot = self.geom_kind >= GeomKind.ROBOT
        model.geom_contype[robot] = model.geom_conaffinity[robot] = 0
        return model

    def part_motion(self, data: mujoco.MjData, p_world: np.ndarray) -> np.ndarray:
        """Unit direction in which a point of the part moves with growing s; p_world (3,) or (n, 3) [m]."""
        joint = self.joint_id
        axis, anchor = data.xaxis[joint], data.xanchor[joint]
        if self.prismatic:
            return np.broadcast_to(axis, np.shape(p_world)).copy()
        sweep = np.cross(axis, np.asarray(p_world) - anchor)
        return sweep / np.maximum(np.linalg.norm(sweep, axis=-1, keepdims=True), 1e-9)

    def axis_at_rest(self) -> np.ndarray:
        """Direction of the object's joint at its reference, world frame, (3,)."""
        data = mujoco.MjData(self.fine)
        mujoco.mj_kinematics(self.fine, data)
        return data.xaxis[self.joint_id].copy()

    def lever(self, data: mujoco.MjData, p_world: np.ndarray) -> np.ndarray:
        """Way that points (n, 3) [m] of the part make per unit of s, (n,): distance from a hinge [m], 1 on a slide."""
        if self.prismatic:
            return np.ones(len(p_world))
        joint = self.joint_id
        return np.linalg.norm(np.cross(data.xaxis[joint], p_world - data.xanchor[joint]), axis=-1)


def build_scene(
    arm: ArmDescription,
    object_mjcf: str | Path,
    joint: str,
    settings: PlanSettings,
    *,
    in_scene: bool = False,
) -> Scene:
    """Put arm, object and table together and compile both models.

    Args:
        arm: The arm; its base stands at the origin of the object file's frame, on the table plane z = 0.
        object_mjcf: MJCF file of the object, in the arm's base frame; its geoms meet the robot only.
        joint: The object's joint that the task is about: a slide or a hinge.
        settings: Time steps and servo gains.
        in_scene: The file is a whole scene instead: the arm stands where its ``arm_base`` is, nothing is added, and
            the scene's geoms also meet each other as the file says.

    Raises:
        SceneFileError: The file cannot be read or compiled, or has no such joint, or no place for the arm.
    """
    given = read_scene(object_mjcf, joint, arm) if in_scene else None
    fine_spec = fine_model_spec(arm, object_mjcf, joint, settings, given)
    fine = _compile(fine_spec, object_mjcf)
    coarse = _compile(_coarse_spec(arm, object_mjcf, joint, settings, given), object_mjcf)
    joint_id = fine.joint(OBJECT_PREFIX + joint).id
    part = int(fine.jnt_bodyid[joint_id])
    limited = bool(fine.jnt_limited[joint_id])
    low, high = fine.jnt_range[joint_id]
    robot_bit = SCENE_ROBOT_BIT if given else _ROBOT_BIT
    return Scene(
        coarse=coarse,
        fine=fine,
        arm=arm,
        joint=joint,
        prismatic=bool(fine.jnt_type[joint_id] == mujoco.mjtJoint.mjJNT_SLIDE),
        s_range=(float(low), float(high)) if limited else None,
        s_qpos=int(fine.jnt_qposadr[joint_id]),
        s_dof=int(fine.jnt_dofadr[joint_id]),
        part_body=part,
        tool_site=fine.site(arm.tool_frame).id,
        geom_kind=_geom_kinds(fine, arm, part),
        solid=(fine.geom_conaffinity & robot_bit) != 0,
        on_table=given is None,
        gravity=fine.opt.gravity.copy(),
        bystanders=fine.nv > arm.dof + 1,
        X_scene_base=given.X_scene_base if given else np.eye(4),
        fine_contacts=int(fine.sensor(_ROBOT_CONTACTS).adr[0]),
    )


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


def _coarse_spec(
    arm: ArmDescription, object_mjcf: str | Path, joint: str, settings: PlanSettings, given: SceneFile | None
) -> mujoco.MjSpec:
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
    if given is None:
        _set_contacts(spec, _ROBOT_BIT, _WORLD_BIT, fine=fine)
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
    """Attach a scene. What MuJoCo warns about are options of the scene that the planner sets itself."""
    thing.memory, thing.njmax, thing.nconmax = spec.memory, spec.njmax, spec.nconmax
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        spec.attach(thing, prefix=OBJECT_PREFIX, frame=frame)


def _add_table(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[2.0, 2.0, 0.1],
        contype=_WORLD_BIT,
        conaffinity=_ROBOT_BIT,
    )


def _compile(spec: mujoco.MjSpec, object_mjcf: str | Path) -> mujoco.MjModel:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SceneFileError(
            f"object file {object_mjcf}: arm and object do not compile together: {one_line(error)}"
        ) from error


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
            geom.contype, geom.conaffinity = _WORLD_BIT, _ROBOT_BIT
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
        joint.solref_friction = [0.004, 1.0]
        joint.solimp_friction = [0.99, 0.999, 0.0001, 0.5, 2.0]


def _meet_robot(scene: mujoco.MjSpec) -> None:
    """Let every solid geom of a scene meet the robot, and each other as before."""
    for geom in scene.geoms:
        geom.margin = geom.gap = 0.0
        if geom.contype or geom.conaffinity:
            geom.contype &= ~SCENE_ROBOT_BIT
            geom.conaffinity |= SCENE_ROBOT_BIT


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
        name=_ROBOT_CONTACTS,
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


def _geom_kinds(model: mujoco.MjModel, arm: ArmDescription, part: int) -> np.ndarray:
    base = model.body(arm.source.base).id
    kinds = np.full(model.ngeom, GeomKind.WORLD)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        chain = _ancestors(model, body)
        if base in chain:
            finger = model.geom(geom).name.startswith(FINGER_PREFIX)
            kinds[geom] = GeomKind.FINGER if finger else GeomKind.ROBOT
        elif part in chain:
            kinds[geom] = GeomKind.PART
    return kinds


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    chain = [body]
    while chain[-1]:
        chain.append(int(model.body_parentid[chain[-1]]))
    return chain
