"""What a pinhole sees: distance, surface normal and geom per pixel, by ray casting (no graphics library needed)."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np


@dataclass(frozen=True, eq=False)
class Hits:
    """Result per ray.

    Attributes:
        distance: In lengths of the ray's vector, -1 where nothing was hit, shape (n,).
        geom: Index of the geom, -1 where nothing was hit, shape (n,).
        normal: Outward unit normal in the world frame, shape (n, 3); arbitrary where nothing was hit.
    """

    distance: np.ndarray
    geom: np.ndarray
    normal: np.ndarray


def cast(
    model: mujoco.MjModel, data: mujoco.MjData, origin: np.ndarray, vectors: np.ndarray, reach_m: float
) -> Hits:
    """Cast rays from one point. Several threads may cast into the same world at once.

    Args:
        model, data: World with positions computed (``mj_kinematics`` is enough).
        origin: In the world frame [m], shape (3,).
        vectors: Ray vectors in the world frame, contiguous, shape (n, 3).
        reach_m: Objects farther than this are not seen.
    """
    count = len(vectors)
    hits = Hits(np.empty(count), np.empty(count, np.int32), np.empty((count, 3)))
    mujoco.mj_multiRay(
        model,
        data,
        origin,
        vectors.reshape(-1),
        None,
        True,
        -1,
        hits.geom,
        hits.distance,
        hits.normal.reshape(-1),
        count,
        reach_m,
    )
    return hits
