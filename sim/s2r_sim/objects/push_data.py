"""``s2r data pushes``: one noisy view per object and what random pushes at visible points do to it.

One ``.npz`` per object: ``depth`` [0.1 mm] uint16, 0 = no return, of the narrower image of
`s2r_sim.objects.pair_data`; ``K``, ``T_base_camera``; per push ``point`` [m], ``direction``,
``delta`` [m or rad], ``useful``, ``blocked``, ``on_part``; the truth about the object: ``label`` per pixel (0 neither,
1 base, 2 part), ``slides``, ``axis_origin`` [m], ``axis_direction``; and ``kind``, ``seed``, ``split``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from s2r_sim.camera.camera import DepthCamera, Sight
from s2r_sim.objects.catalogue import KINDS, ObjectSpec
from s2r_sim.objects.naming import BASE_BODY, PART_BODY
from s2r_sim.objects.pair_data import UNIT_M, narrow_rig
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.pushes import USEFUL_M, USEFUL_RAD, PushScene, useful
from s2r_sim.objects.scene import joint_truth, qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng

CONE_RAD = np.deg2rad(70)
PART_SHARE = 0.6  # of the pushes; the rest goes to any visible surface of the object
ROOM = 1.3  # the part can move this many times the useful amount
NEITHER, BASE, PART = 0, 1, 2


def push_object(kind: str, split: int, seed: int, pushes: int, folder: str) -> dict[str, Any]:
    """Draw object and view, push at random, write the file; counts for the progress log."""
    rng = split_rng(kind, Split(split), seed)
    spec = with_room(rng, KINDS[kind].draw(rng))
    model = table_scene(spec).compile()
    qpos = qpos_at(model, spec.q_start)
    camera = DepthCamera(model, place_camera(rng, model, spec.q_start)[0], narrow_rig(kind))
    sight = camera.exact_sight(qpos)
    depth = camera.capture(qpos).depth_m
    label = pixel_labels(sight, model.body(BASE_BODY).id, model.body(PART_BODY).id)
    points, directions, on_part = draw_pushes(
        rng, seen_points(depth, camera.rig.K, camera.X_base_camera), sight.normal, label, pushes
    )
    scene = PushScene(spec)
    results = [scene.push(p, d) for p, d in zip(points, directions, strict=True)]
    good = np.array([useful(kind, r.delta) for r in results], dtype=bool)
    joint = joint_truth(model, spec)
    path = Path(folder) / f"{kind}-{Split(split).name.lower()}-{seed:05d}.npz"
    np.savez_compressed(
        path,
        depth=np.clip(np.rint(depth / UNIT_M), 0, np.iinfo(np.uint16).max).astype(np.uint16),
        K=camera.rig.K,
        T_base_camera=camera.X_base_camera,
        point=points.astype(np.float32),
        direction=directions.astype(np.float32),
        delta=np.array([r.delta for r in results], np.float32),
        blocked=np.array([r.blocked for r in results], dtype=bool),
        useful=good,
        on_part=on_part,
        label=label,
        slides=joint.joint_type == "prismatic",
        axis_origin=np.array(joint.origin_m),
        axis_direction=np.array(joint.direction),
        kind=kind,
        split=split,
        seed=seed,
    )
    return {"file": path.name, "pushes": len(results), "useful": int(good.sum())}


def pixel_labels(sight: Sight, base: int, part: int) -> np.ndarray:
    """What every pixel truly shows: `NEITHER`, `BASE` or `PART`, shape (height, width), uint8."""
    label = np.full(sight.body.shape, NEITHER, np.uint8)
    label[sight.body == base] = BASE
    label[sight.body == part] = PART
    return label


def seen_points(depth: np.ndarray, K: np.ndarray, X_base_camera: np.ndarray) -> np.ndarray:
    """Base-frame points [m] of a depth image as the camera measured it, NaN where it has none, (height, width, 3)."""
    v, u = np.indices(depth.shape)
    z = np.where(depth > 0, depth, np.nan)
    p_C = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=-1)
    return p_C @ X_base_camera[:3, :3].T + X_base_camera[:3, 3]


def draw_pushes(
    rng: np.random.Generator, point: np.ndarray, normal: np.ndarray, label: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random visible points of the object with directions within 70 degrees of straight in.

    Args:
        rng: Of points and directions.
        point: Where a host believes each pixel to be [m], NaN for no depth, shape (height, width, 3).
        normal: True normals towards the camera, same shape.
        label: See `pixel_labels`.
        count: Of pushes.

    Returns:
        Points (n, 3), unit directions (n, 3) and whether each point lies on the part (n,). None at all if the object
        is out of sight.
    """
    flat, p = label.ravel(), point.reshape(-1, 3)
    measured = np.isfinite(p[:, 2])
    of_part = np.flatnonzero((flat == PART) & measured)
    of_object = np.flatnonzero((flat != NEITHER) & measured)
    if len(of_object) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool)
    first = round(PART_SHARE * count) if len(of_part) else 0
    chosen = rng.choice(of_object, count - first)
    if first:
        chosen = np.concatenate([rng.choice(of_part, first), chosen])
    inward = -normal.reshape(-1, 3)[chosen]
    helper = rng.normal(size=inward.shape)
    across = np.cross(inward, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.arccos(rng.uniform(np.cos(CONE_RAD), 1.0, len(chosen)))[:, None]
    return p[chosen], np.cos(angle) * inward + np.sin(angle) * across, flat[chosen] == PART


def with_room(rng: np.random.Generator, spec: ObjectSpec) -> ObjectSpec:
    """The object in a state from which the part can move usefully towards 0, as a push can."""
    least = ROOM * (USEFUL_M if KINDS[spec.kind].slides else USEFUL_RAD)
    q = float(rng.uniform(min(least, 0.5 * spec.q_max), 0.9 * spec.q_max))
    return spec.model_copy(update={"opening_m" if spec.kind == "drawer" else "q_start": q})
