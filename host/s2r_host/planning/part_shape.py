"""The shape of the part that is moved: its solid geoms, the box around them, its longest lever."""

from __future__ import annotations

from itertools import product

import mujoco
import numpy as np

from s2r_host.planning.scene import GeomKind, Scene


def part_geoms(scene: Scene) -> np.ndarray:
    """Indices of the geoms of the part that can be touched."""
    return np.flatnonzero((scene.geom_kind == GeomKind.PART) & scene.solid)


def part_box(scene: Scene, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Axis-aligned box of the part's colliding geoms in the world, two (3,) [m]."""
    corners = _corners(scene, data)
    return corners.min(axis=0), corners.max(axis=0)


def outermost_lever(scene: Scene, data: mujoco.MjData) -> float:
    """Way that the outermost point of the part makes per unit of s: a radius [m] about a hinge, 1 on a slide."""
    return float(scene.lever(data, _corners(scene, data)).max())


def _corners(scene: Scene, data: mujoco.MjData) -> np.ndarray:
    """Corners of the boxes around the part's geoms in the world [m], (8 n, 3)."""
    geoms = part_geoms(scene)
    signs = np.array(list(product((-1.0, 1.0), repeat=3)))
    local = scene.fine.geom_aabb[geoms, None, :3] + signs * scene.fine.geom_aabb[geoms, None, 3:]
    R = data.geom_xmat[geoms].reshape(-1, 3, 3)
    return (data.geom_xpos[geoms, None] + np.einsum("gij,gkj->gki", R, local)).reshape(-1, 3)
