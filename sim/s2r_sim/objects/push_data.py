"""``s2r data pushes``: one noisy view per object and what random pushes at visible points do to it.

One ``.npz`` per object: ``depth`` [m], ``K``, ``T_base_camera``; per push ``point`` [m], ``direction``,
``delta`` [m or rad], ``useful``, ``blocked``, ``on_part``; and ``kind``, ``seed``, ``split``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from s2r_sim.camera.camera import DepthCamera, Sight
from s2r_sim.objects.catalogue import KINDS, ObjectSpec
from s2r_sim.objects.naming import BASE_BODY, PART_BODY
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.pushes import USEFUL_M, USEFUL_RAD, PushScene, useful
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng

CONE_RAD = np.deg2rad(70)
PART_SHARE = 0.6  # of the pushes; the rest goes to any visible surface of the object
ROOM = 1.3  # the part can move this many times the useful amount


def push_object(kind: str, split: int, seed: int, pushes: int, folder: str) -> dict[str, Any]:
    """Draw object and view, push at random, write the file; counts for the progress log."""
    rng = split_rng(kind, Split(split), seed)
    spec = with_room(rng, KINDS[kind].draw(rng))
    model = table_scene(spec).compile()
    qpos = qpos_at(model, spec.q_start)
    camera = DepthCamera(model, place_camera(rng, model, spec.q_start)[0])
    sight = camera.exact_sight(qpos)
    points, directions, on_part = draw_pushes(
        rng, sight, model.body(BASE_BODY).id, model.body(PART_BODY).id, pushes
    )
    scene = PushScene(spec)
    results = [scene.push(p, d) for p, d in zip(points, directions, strict=True)]
    good = np.array([useful(kind, r.delta) for r in results], dtype=bool)
    path = Path(folder) / f"{kind}-{Split(split).name.lower()}-{seed:05d}.npz"
    np.savez_compressed(
        path,
        depth=camera.capture(qpos).depth_m,
        K=camera.rig.K,
        T_base_camera=camera.X_base_camera,
        point=points.astype(np.float32),
        direction=directions.astype(np.float32),
        delta=np.array([r.delta for r in results], np.float32),
        blocked=np.array([r.blocked for r in results]),
        useful=good,
        on_part=on_part,
        kind=kind,
        split=split,
        seed=seed,
    )
    return {"file": path.name, "pushes": len(results), "useful": int(good.sum())}


def draw_pushes(
    rng: np.random.Generator, sight: Sight, base: int, part: int, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random visible points of the object with directions within 70 degrees of straight in.

    Returns:
        Points (n, 3), unit directions (n, 3) and whether each point lies on the part (n,). None at all if the object
        is out of sight.
    """
    body = sight.body.ravel()
    of_part, of_object = np.flatnonzero(body == part), np.flatnonzero((body == part) | (body == base))
    if len(of_object) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool)
    first = round(PART_SHARE * count) if len(of_part) else 0
    chosen = np.concatenate([rng.choice(of_part, first), rng.choice(of_object, count - first)])
    inward = -sight.normal.reshape(-1, 3)[chosen]
    helper = rng.normal(size=inward.shape)
    across = np.cross(inward, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.arccos(rng.uniform(np.cos(CONE_RAD), 1.0, len(chosen)))[:, None]
    return (
        sight.point.reshape(-1, 3)[chosen],
        np.cos(angle) * inward + np.sin(angle) * across,
        body[chosen] == part,
    )


def with_room(rng: np.random.Generator, spec: ObjectSpec) -> ObjectSpec:
    """The object in a state from which the part can move usefully towards 0, as a push can."""
    least = ROOM * (USEFUL_M if KINDS[spec.kind].slides else USEFUL_RAD)
    q = float(rng.uniform(min(least, 0.5 * spec.q_max), 0.9 * spec.q_max))
    return spec.model_copy(update={"opening_m" if spec.kind == "drawer" else "q_start": q})
