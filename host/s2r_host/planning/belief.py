"""Models of an object that are all believable, as they differ from the one in its file."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import mujoco
import mujoco.batch
import numpy as np

from s2r_host.planning.doubt import CHI90, Z90, Doubt
from s2r_host.planning.scene import GeomKind, Scene
from s2r_host.planning.scene_spec import SCENE_ROBOT_BIT

Vector = tuple[float, float, float]
_NOWHERE: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Belief:
    """One believable object, as it differs from the object file.

    Attributes:
        shift_m: Displacement of the whole object in the world frame.
        friction: Factor on the friction between robot and object.
        damping: Factor on the viscous damping of the object's joint.
        joint_friction: Factor on the dry friction of the object's joint.
        tilt_rad: Added to the unit vector along the joint's axis, world frame; what lies along the axis does nothing.
            At the joint's reference the part is where the file has it.
        pivot_m: Displacement of a hinge's axis in the world frame, in the same way.
        along: The part stands so much further along its joint than the joint's value says [m or rad].
    """

    shift_m: Vector = _NOWHERE
    friction: float = 1.0
    damping: float = 1.0
    joint_friction: float = 1.0
    tilt_rad: Vector = _NOWHERE
    pivot_m: Vector = _NOWHERE
    along: float = 0.0

    def __str__(self) -> str:
        parts = []
        if any(self.shift_m):
            parts.append(f"object moved by {_shown(self.shift_m, 1e3)} mm")
        if any(self.tilt_rad):
            parts.append(f"joint axis tilted by {_shown(self.tilt_rad, 57.29578)}°")
        if any(self.pivot_m):
            parts.append(f"pivot moved by {_shown(self.pivot_m, 1e3)} mm")
        if self.along:
            parts.append(f"part {self.along:+.4f} along its joint")
        if self.damping == self.joint_friction:
            parts.append(f"joint resistance × {self.damping:g}")
        else:
            parts.append(f"joint damping × {self.damping:g}, dry friction × {self.joint_friction:g}")
        return ", ".join([*parts, f"friction × {self.friction:g}"])

    @property
    def moves_joint(self) -> bool:
        """Whether the joint or the part's place along it differs from the file's."""
        return any(self.tilt_rad) or any(self.pivot_m) or self.along != 0.0

    def applied(self, scene: Scene) -> Scene:
        """The scene with its fine model changed; the given one stays as it is."""
        model = copy.copy(scene.fine)
        body, sign = moved_body(scene)
        model.body_pos[body] += sign * np.array(self.shift_m)
        model.dof_damping[scene.s_dof] *= self.damping
        model.dof_frictionloss[scene.s_dof] *= self.joint_friction
        model.geom_friction[scene.geom_kind >= GeomKind.ROBOT, 0] *= self.friction
        if self.moves_joint:
            place, joint = _joint_place(scene, self), scene.joint_id
            model.jnt_axis[joint], model.jnt_pos[joint] = place.axis, place.pivot
            model.body_pos[scene.part_body] += place.body_shift
            model.body_quat[scene.part_body] = place.body_quat_wxyz
            if not scene.on_table:
                let_part_pass(model, scene)
            mujoco.mj_setConst(model, mujoco.MjData(model))
        return replace(scene, fine=model)


def let_part_pass(model: mujoco.MjModel, scene: Scene) -> None:
    """Let the part of a whole scene meet the robot only.

    A drawer fits into its cabinet however wrong its axis is believed: tilted by itself it would jam at the walls.
    """
    part = (scene.geom_kind == GeomKind.PART) & scene.solid
    model.geom_contype[part], model.geom_conaffinity[part] = 0, SCENE_ROBOT_BIT


def draw_belief(doubt: Doubt, rng: np.random.Generator) -> Belief:
    """A believable object at random: factors uniform, places and angles Gaussian."""
    return _belief_at(doubt, *_chances(doubt, rng))


def draw_ensemble(doubt: Doubt, count: int, rng: np.random.Generator) -> tuple[Belief, ...]:
    """The object file's object and ``count - 1`` others, ``count`` odd: in opposite pairs they are not one-sided."""
    found = [Belief()]
    for _ in range(count // 2):
        chances = _chances(doubt, rng)
        found += [_belief_at(doubt, *chances), _belief_at(doubt, *(-part for part in chances))]
    return tuple(found)


def _chances(doubt: Doubt, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where in the intervals: shares within [-1, 1] (3,), displacement [m] (3,), of the joint in deviations (7,)."""
    shares, shift = rng.uniform(-1.0, 1.0, 3), rng.normal(0.0, doubt.shift_sigma_m, 3)
    return shares, shift, rng.normal(0.0, 1.0, 7) if doubt.about_joint else np.zeros(7)


def _belief_at(doubt: Doubt, shares: np.ndarray, shift_m: np.ndarray, joint: np.ndarray) -> Belief:
    spans = np.array([doubt.friction, doubt.damping, doubt.joint_friction])
    factors = spans.mean(axis=1) + shares * (spans[:, 1] - spans[:, 0]) / 2.0
    # Across the axis two of the three components remain: the radius that holds 90 % of them is CHI90[2].
    tilt, pivot = doubt.axis_angle_rad / CHI90[2] * joint[:3], doubt.axis_offset_m / CHI90[2] * joint[3:6]
    return Belief(
        _vector(shift_m), *factors.tolist(), tilt_rad=_vector(tilt), pivot_m=_vector(pivot),
        along=float(doubt.along / Z90 * joint[6]),
    )  # fmt: skip


def moved_body(scene: Scene) -> tuple[int, float]:
    """The body whose displacement moves the object against the arm, and the sign to move it with."""
    if scene.on_table:
        return int(scene.fine.body_rootid[scene.part_body]), 1.0
    # In a scene the object may consist of several trees: move the arm instead.
    return int(scene.fine.body(scene.arm.source.base).id), -1.0


def spread_over(batch: mujoco.batch.Batch, scene: Scene, beliefs: tuple[Belief, ...]) -> None:
    """Give simulation i of a batch of one of the scene's models the object ``beliefs[i % len(beliefs)]``."""
    member = np.arange(batch.nsim) % len(beliefs)
    body, sign = moved_body(scene)
    robot = np.flatnonzero(scene.geom_kind >= GeomKind.ROBOT)
    place, friction = batch.expand("body_pos"), batch.expand("geom_friction")
    damping, dry = batch.expand("dof_damping"), batch.expand("dof_frictionloss")
    place[:, body] += sign * np.array([b.shift_m for b in beliefs])[member]
    friction[:, robot, 0] *= np.array([b.friction for b in beliefs])[member, None]
    damping[:, scene.s_dof] *= np.array([b.damping for b in beliefs])[member]
    dry[:, scene.s_dof] *= np.array([b.joint_friction for b in beliefs])[member]
    # The rollout model's near misses stand for errors that the others have in full: both together leave no room.
    nearly = np.array([b == Belief() for b in beliefs], dtype=float)[member, None]
    for field in ("geom_margin", "geom_gap"):
        batch.expand(field)[:, robot] *= nearly
    if any(b.moves_joint for b in beliefs):
        places = [_joint_place(scene, b) for b in beliefs]
        turned, joint = batch.expand("body_quat"), scene.joint_id
        axis, pivot = batch.expand("jnt_axis"), batch.expand("jnt_pos")
        place[:, scene.part_body] += np.array([p.body_shift for p in places])[member]
        turned[:, scene.part_body] = np.array([p.body_quat_wxyz for p in places])[member]
        axis[:, joint] = np.array([p.axis for p in places])[member]
        pivot[:, joint] = np.array([p.pivot for p in places])[member]
    batch.set_const()


@dataclass(frozen=True, eq=False)
class _JointPlace:
    """Joint and part of a believable object, as MuJoCo has them.

    Attributes:
        axis, pivot: In the part's frame, (3,).
        body_shift: Added to the part's place in its parent's frame [m], (3,).
        body_quat_wxyz: The part's orientation in it, (4,).
    """

    axis: np.ndarray
    pivot: np.ndarray
    body_shift: np.ndarray
    body_quat_wxyz: np.ndarray


def _joint_place(scene: Scene, belief: Belief) -> _JointPlace:
    model, joint, part = scene.fine, scene.joint_id, scene.part_body
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    R_part_world = data.xmat[part].reshape(3, 3).T
    axis = model.jnt_axis[joint].copy()

    def across(vector: Vector) -> np.ndarray:
        in_part = R_part_world @ np.array(vector)
        return in_part - (in_part @ axis) * axis

    tilted = axis + across(belief.tilt_rad)
    tilted /= np.linalg.norm(tilted)
    pivot = model.jnt_pos[joint] + across(belief.pivot_m)
    quat = model.body_quat[part].copy()
    if scene.prismatic:
        shift = np.empty(3)
        mujoco.mju_rotVecQuat(shift, belief.along * tilted, quat)
        return _JointPlace(tilted, pivot, shift, quat)
    turn, turned = np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(turn, tilted, belief.along)
    mujoco.mju_mulQuat(turned, quat, turn)
    before, after = np.empty(3), np.empty(3)
    mujoco.mju_rotVecQuat(before, pivot, quat)
    mujoco.mju_rotVecQuat(after, pivot, turned)
    return _JointPlace(tilted, pivot, before - after, turned)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def _shown(vector: Vector, factor: float) -> str:
    return "(" + ", ".join(f"{factor * v:+.1f}" for v in vector) + ")"
