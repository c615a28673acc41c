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
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.motion.links_apart import LinksApart
from s2r_host.object_names import RIM_PREFIX
from s2r_host.planning.scene_file import SceneFileError, one_line, read_scene
from s2r_host.planning.scene_spec import (
    OBJECT_PREFIX,
    ROBOT_BIT,
    ROBOT_CONTACTS,
    SCENE_ROBOT_BIT,
    coarse_model_spec,
    fine_model_spec,
)
from s2r_host.planning.settings import PlanSettings, Stage
from s2r_protocol.arms import ArmDescription
from s2r_protocol.arms.source import FINGER_PREFIX


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
        rims: Of the part, which nothing touches and the real part may reach to (``rim_*``), bool (ngeom,).
        on_table: The world frame's plane z = 0 is a table that the planner has added.
        gravity: In the arm's base frame [m/s²], (3,).
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
    rims: np.ndarray
    on_table: bool
    gravity: np.ndarray
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

    @property
    def axis_stays(self) -> bool:
        """Whether the joint's axis stands still in the world: nothing that carries the part can move."""
        return bool(self.fine.body_weldid[self.fine.body_parentid[self.part_body]] == 0)

    @cached_property
    def links(self) -> LinksApart:
        """Tells postures of the arm that the executor refuses for links that are too near to each other."""
        return LinksApart(self.arm)

    def rollout_model(self, stage: Stage) -> mujoco.MjModel:
        """The coarse model at a stage's time step, with or without the arm's collisions with itself."""
        model = copy.copy(self.coarse)
        model.opt.timestep = stage.timestep_s
        if stage.self_collision:
            robot = self.geom_kind >= GeomKind.ROBOT
            model.geom_conaffinity[robot] |= model.geom_contype[robot]
            # Bodies have bits of their own, by which pairs are left out before any geom is looked at.
            links = np.unique(model.geom_bodyid[robot])
            model.body_conaffinity[links] |= model.body_contype[links]
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
    coarse = _compile(coarse_model_spec(arm, object_mjcf, joint, settings, given), object_mjcf)
    joint_id = fine.joint(OBJECT_PREFIX + joint).id
    part = int(fine.jnt_bodyid[joint_id])
    limited = bool(fine.jnt_limited[joint_id])
    low, high = fine.jnt_range[joint_id]
    robot_bit = SCENE_ROBOT_BIT if given else ROBOT_BIT
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
        rims=_rims(fine, part),
        on_table=given is None,
        gravity=fine.opt.gravity.copy(),
        X_scene_base=given.X_scene_base if given else np.eye(4),
        fine_contacts=int(fine.sensor(ROBOT_CONTACTS).adr[0]),
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


def _rims(model: mujoco.MjModel, part: int) -> np.ndarray:
    named = (model.geom(geom).name.startswith(OBJECT_PREFIX + RIM_PREFIX) for geom in range(model.ngeom))
    return np.fromiter(named, bool, model.ngeom) & (model.geom_bodyid == part)


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    chain = [body]
    while chain[-1]:
        chain.append(int(model.body_parentid[chain[-1]]))
    return chain
