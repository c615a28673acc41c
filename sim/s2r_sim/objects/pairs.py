"""Pairs of noisy depth views of one object before and after a motion, with the truth: for benches and for
training.

Camera 0.65 to 0.95 m from the moving part, up to 60 degrees to either side of the object's front and 15 to 45
degrees above it; the motion is 8 to 50 % of the joint's range, but at least what a first push is asked for (3
cm or 15 degrees).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_sim.camera.camera import DepthCamera
from s2r_sim.camera.intrinsics import StereoRig
from s2r_sim.objects.catalogue import ObjectSpec, kind_named
from s2r_sim.objects.naming import BASE_BODY, PART_BODY
from s2r_sim.objects.scene import JointTruth, joint_truth, qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng
from s2r_sim.world import CameraTruth

PUSH_M, PUSH_RAD = 0.03, np.deg2rad(15)
LEAST_SHARE, MOST_SHARE = 0.08, 0.5
AZIMUTH_RAD = np.deg2rad(60)
ELEVATION_RAD = (np.deg2rad(15), np.deg2rad(45))
DISTANCE_M = (0.65, 0.95)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two views of one object.

    Attributes:
        spec: The object.
        joint: Its joint as found.
        depth_before, depth_after: Noisy depth [m], 0 = no return, shape (height, width), float32.
        colour_before, colour_after: RGB, shape (height, width, 3), uint8.
        part_before, part_after: Pixels of the moving part, by exact ray casting, shape (height, width).
        K: Pinhole matrix.
        X_base_camera: Pose of the camera, shape (4, 4).
        delta: Joint motion from the first to the second view, signed [m or rad].
        azimuth_rad, elevation_rad, distance_m: Of the camera, seen from the part.
        part_points: Corners of the part's solids in the first view, arm base frame [m], shape (n, 3).
    """

    spec: ObjectSpec
    joint: JointTruth
    depth_before: np.ndarray
    depth_after: np.ndarray
    colour_before: np.ndarray
    colour_after: np.ndarray
    part_before: np.ndarray
    part_after: np.ndarray
    K: np.ndarray
    X_base_camera: np.ndarray
    delta: float
    azimuth_rad: float
    elevation_rad: float
    distance_m: float
    part_points: np.ndarray


def draw_pair(
    kind: str,
    split: Split,
    seed: int,
    *,
    least_share: float = LEAST_SHARE,
    rig: StereoRig | None = None,
    noise: bool = True,
) -> Pair:
    """Draw object, camera and motion, and look twice.

    Args:
        kind: Kind of object.
        split: What the pair is for.
        seed: Its number.
        least_share: Smallest motion as a share of the range; 0.08 with the push's own minimum on top.
        rig: The camera's geometry.
        noise: Exact depth if False.
    """
    entry = kind_named(kind)
    rng = split_rng(kind, split, seed)
    spec = entry.draw(rng)
    least = max(least_share * spec.q_max, PUSH_M if entry.slides else PUSH_RAD)
    q, delta = draw_motion(rng, spec, least)
    spec = at_joint_value(spec, q)
    model = table_scene(spec).compile()
    camera_truth, azimuth, elevation, distance = place_camera(rng, model, q)
    points, part = part_points(model, q), model.body(PART_BODY).id
    camera = DepthCamera(model, camera_truth, rig)
    qpos_a, qpos_b = qpos_at(model, q), qpos_at(model, q + delta)
    view_a = camera.capture(qpos_a)
    depth_a = view_a.depth_m if noise else camera.exact_depth(qpos_a).astype(np.float32)
    view_b = camera.capture(qpos_b)
    depth_b = view_b.depth_m if noise else camera.exact_depth(qpos_b).astype(np.float32)
    return Pair(
        spec,
        joint_truth(model, spec),
        depth_a,
        depth_b,
        view_a.colour,
        view_b.colour,
        camera.exact_sight(qpos_a).body == part,
        camera.exact_sight(qpos_b).body == part,
        camera.rig.K,
        camera.X_base_camera,
        delta,
        azimuth,
        elevation,
        distance,
        points,
    )


def place_camera(
    rng: np.random.Generator, model: mujoco.MjModel, q: float
) -> tuple[CameraTruth, float, float, float]:
    """A camera that looks at the part: it, azimuth and elevation [rad] seen from the object's front, distance [m]."""
    azimuth, elevation = rng.uniform(-AZIMUTH_RAD, AZIMUTH_RAD), rng.uniform(*ELEVATION_RAD)
    distance = rng.uniform(*DISTANCE_M)
    points = part_points(model, q)
    target = (points.min(axis=0) + points.max(axis=0)) / 2 + rng.uniform(-0.03, 0.03, 3)
    facing = _yaw(model)
    outward = np.array(
        [
            np.cos(elevation) * np.cos(facing + azimuth),
            np.cos(elevation) * np.sin(facing + azimuth),
            np.sin(elevation),
        ]
    )
    truth = CameraTruth(
        position_m=_triple(target + distance * outward),
        target_m=_triple(target),
        roll_rad=float(rng.uniform(-0.04, 0.04)),
        hand_eye_m=(0.0, 0.0, 0.0),
        hand_eye_rad=(0.0, 0.0, 0.0),
        seed=int(rng.integers(2**31)),
    )
    return truth, azimuth, elevation, distance


def camera_of(pair: Pair, model: mujoco.MjModel, seed: int = 0) -> DepthCamera:
    """The camera of a pair at the same place, for more views of its object; ``seed`` is that of their noise."""
    p, z = pair.X_base_camera[:3, 3], pair.X_base_camera[:3, 2]
    level = np.cross(z, [0.0, 0.0, 1.0])
    level /= np.linalg.norm(level)
    x = pair.X_base_camera[:3, 0]
    truth = CameraTruth(
        position_m=_triple(p),
        target_m=_triple(p + z),
        roll_rad=float(np.arctan2(x @ np.cross(z, level), x @ level)),
        hand_eye_m=(0.0, 0.0, 0.0),
        hand_eye_rad=(0.0, 0.0, 0.0),
        seed=seed,
    )
    return DepthCamera(model, truth)


def part_points(model: mujoco.MjModel, q: float) -> np.ndarray:
    """Corners of the boxes around the part's solids [m], arm base frame, shape (8 * solids, 3)."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos_at(model, q)
    mujoco.mj_kinematics(model, data)
    part = model.body(PART_BODY).id
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = []
    for geom in np.flatnonzero(model.geom_bodyid == part):
        box = model.geom_aabb[geom]
        local = box[:3] + signs * box[3:]
        corners.append(local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
    return np.concatenate(corners)


def draw_motion(rng: np.random.Generator, spec: ObjectSpec, least: float) -> tuple[float, float]:
    """Joint value before, and the motion of ``least`` or more [m or rad]; both ends within the range."""
    amount = float(rng.uniform(least, max(MOST_SHARE * spec.q_max, least * 1.01)))
    q = float(rng.uniform(0, spec.q_max - amount))
    return (q, amount) if rng.uniform() < 0.5 else (q + amount, -amount)


def at_joint_value(spec: ObjectSpec, q: float) -> ObjectSpec:
    """The object found at the joint value ``q`` [m or rad]."""
    field = "opening_m" if "opening_m" in type(spec).model_fields else "q_start"
    return spec.model_copy(update={field: q})


def _yaw(model: mujoco.MjModel) -> float:
    """Direction of the object's front about the vertical [rad]."""
    w, _, _, z = model.body(BASE_BODY).quat
    return float(2 * np.arctan2(z, w))


def _triple(p: np.ndarray) -> tuple[float, float, float]:
    return float(p[0]), float(p[1]), float(p[2])
