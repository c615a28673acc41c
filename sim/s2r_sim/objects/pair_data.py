"""``s2r data pairs``: depth views of one object with its part in two or three places, and the joint between them.

One ``.npz`` per object: ``depth`` [0.1 mm] (states, height, width) uint16, 0 = no return; ``part`` pixels of the moving
part by exact ray casting, packed bits of the same shape; ``q`` joint values [m or rad] (states,); ``least`` smallest
motion that a first push is asked for; ``K``, ``T_base_camera``; ``slides``, ``axis_origin`` [m], ``axis_direction``
(with the sense of growing joint values), arm base frame; ``spokes``: after 1/spokes of a turn the part looks the same;
``solids`` of the part in the first state, see `part_solids`; and ``kind``, ``seed``, ``split``.

The camera is that of `s2r_sim.objects.pairs`, stereo matching included, with the same focal length but a narrower
image: it looks at the part anyway, and a pixel costs what it costs. Any two of the states make a pair, so that three
views give three pairs. Both together bring a pair from 0.8 to 1.3 s of CPU down to about 0.4 s.
With ``quick`` the errors of the depth are drawn (`s2r_sim.camera.drawn_errors`) and the image is coarser or narrower
still: 0.05 s a pair.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from s2r_sim.camera.camera import DepthCamera, Sight, bias_waves
from s2r_sim.camera.drawn_errors import depth_with_drawn_errors
from s2r_sim.camera.intrinsics import StereoRig
from s2r_sim.objects.catalogue import KINDS, ObjectSpec
from s2r_sim.objects.naming import PART_BODY
from s2r_sim.objects.pairs import (
    LEAST_SHARE,
    MOST_SHARE,
    PUSH_M,
    PUSH_RAD,
    at_joint_value,
    draw_motion,
    place_camera,
)
from s2r_sim.objects.scene import joint_truth, qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng

UNIT_M = 1e-4
SMALL, LARGE = (480, 400), (672, 480)  # width, height [px]
QUICK_SMALL = StereoRig(width=360, height=320)
QUICK_LARGE = StereoRig(width=336, height=240, f_px=333.0)
SMALL_KINDS = ("faucet", "dial")
TRIES = 30


def pair_object(kind: str, split: int, seed: int, folder: str, quick: bool = False) -> dict[str, Any]:
    """Draw object, camera and states, look at each, write the file; counts for the progress log."""
    entry = KINDS[kind]
    rng = split_rng(kind, Split(split), seed)
    spec = entry.draw(rng)
    least = max(LEAST_SHARE * spec.q_max, PUSH_M if entry.slides else PUSH_RAD)
    q = draw_states(rng, spec, least)
    spec = at_joint_value(spec, float(q[0]))
    model = table_scene(spec).compile()
    camera = DepthCamera(model, place_camera(rng, model, float(q[0]))[0], narrow_rig(kind, quick))
    part = model.body(PART_BODY).id
    poses = [qpos_at(model, float(value)) for value in q]
    sights = [camera.exact_sight(pose) for pose in poses]
    seen = np.stack([sight.body == part for sight in sights])
    if quick:
        bias = bias_waves(rng, camera.rig.height, camera.rig.width)
        depth = np.stack([_quick_depth(camera, sight, bias, rng) for sight in sights])
    else:
        depth = np.stack([camera.capture(pose).depth_m for pose in poses])
    joint = joint_truth(model, spec)
    path = Path(folder) / f"{kind}-{Split(split).name.lower()}-{seed:05d}{'-quick' if quick else ''}.npz"
    np.savez_compressed(
        path,
        depth=np.clip(np.rint(depth / UNIT_M), 0, np.iinfo(np.uint16).max).astype(np.uint16),
        part=np.packbits(seen, axis=-1),
        q=q,
        least=least,
        K=camera.rig.K,
        T_base_camera=camera.X_base_camera,
        slides=joint.joint_type == "prismatic",
        axis_origin=np.array(joint.origin_m),
        axis_direction=np.array(joint.direction),
        spokes=getattr(spec, "spokes", 1),
        solids=part_solids(model, poses[0]),
        kind=kind,
        split=split,
        seed=seed,
    )
    return {"file": path.name, "states": len(q), "pairs": len(q) * (len(q) - 1) // 2}


def part_solids(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """What the part is made of, exactly: (n, 16), one row per solid, arm base frame.

    Columns: MuJoCo's number of the shape (`mujoco.mjtGeom`), its three sizes [m], its pose (3, 4) row by row.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    geoms = np.flatnonzero(model.geom_bodyid == model.body(PART_BODY).id)
    pose = np.concatenate(
        [data.geom_xmat[geoms].reshape(-1, 3, 3), data.geom_xpos[geoms].reshape(-1, 3, 1)], axis=2
    )
    shape = model.geom_type[geoms].astype(float)[:, None]
    return np.concatenate([shape, model.geom_size[geoms], pose.reshape(-1, 12)], axis=1)


def _quick_depth(
    camera: DepthCamera, sight: Sight, bias_px: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Depth of an exact view with drawn errors [m]."""
    X = camera.X_base_camera
    ray = sight.point - X[:3, 3]
    there = sight.body >= 0
    exact = np.where(there, ray @ X[:3, 2], 0.0)
    cosine = np.abs(np.einsum("hwi,hwi->hw", ray, sight.normal)) / np.maximum(
        np.linalg.norm(ray, axis=2), 1e-6
    )
    return depth_with_drawn_errors(exact, np.where(there, cosine, 1.0), camera.rig, bias_px, rng)


def narrow_rig(kind: str, quick: bool = False) -> StereoRig:
    """A camera for training data: as wide an image as a kind of object needs."""
    if quick:
        return QUICK_SMALL if kind in SMALL_KINDS else QUICK_LARGE
    width, height = SMALL if kind in SMALL_KINDS else LARGE
    return StereoRig(width=width, height=height)


def draw_states(rng: np.random.Generator, spec: ObjectSpec, least: float) -> np.ndarray:
    """Joint values: two as `s2r_sim.objects.pairs` draws them, and if there is room a third, (2,) or (3,).

    Any two differ by ``least`` or more [m or rad]; the third lies within half of the range of one of the others.
    """
    q, amount = draw_motion(rng, spec, least)
    states = [q, q + amount]
    for value in rng.uniform(0, spec.q_max, TRIES):
        gap = np.abs(np.array(states) - value)
        if gap.min() >= least and gap.min() <= MOST_SHARE * spec.q_max:
            return np.array([*states, float(value)])
    return np.array(states)
