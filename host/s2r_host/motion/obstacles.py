"""What the arm must not touch: the observed cloud, the space behind it, the table, a built object model."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np

VOXEL_M = 0.01
SHADOW_DEPTH_M = 0.12


@dataclass(frozen=True, eq=False)
class Obstacle:
    """One rigid shape in the base frame. ``X_base_shape`` has shape (4, 4)."""

    name: str
    geometry: coal.CollisionGeometry
    X_base_shape: np.ndarray


def voxels(p_base: np.ndarray, size_m: float = VOXEL_M) -> np.ndarray:
    """Centres of the occupied voxels, shape (m, 3), of points of shape (n, 3) [m]."""
    if len(p_base) == 0:
        return np.zeros((0, 3))
    cells = np.unique(np.floor(p_base / size_m).astype(np.int64), axis=0)
    return (cells + 0.5) * size_m


def shadow(p_base: np.ndarray, p_camera: np.ndarray, depth_m: float = SHADOW_DEPTH_M) -> np.ndarray:
    """Points behind the seen ones, away from the camera: unseen space close behind a surface is taken as solid.

    Args:
        p_base: Seen points [m], shape (n, 3).
        p_camera: Position of the camera in the base frame [m], shape (3,).
        depth_m: How far behind the surface [m].

    Returns:
        Seen and unseen points, shape (m, 3), those below the table left out.
    """
    rays = p_base - p_camera
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    steps = np.arange(0.0, depth_m + 1e-9, VOXEL_M)
    filled = (p_base[:, None, :] + steps[None, :, None] * rays[:, None, :]).reshape(-1, 3)
    return filled[filled[:, 2] > 0.0]


def cloud_obstacle(
    p_base: np.ndarray,
    p_camera: np.ndarray | None = None,
    name: str = "observed object",
    shadow_m: float = SHADOW_DEPTH_M,
) -> Obstacle:
    """The observed points as an octree of 1 cm voxels; with ``p_camera`` so much space behind them is filled too."""
    points = voxels(p_base)
    if p_camera is not None and len(points):
        points = voxels(shadow(points, p_camera, shadow_m))
    return Obstacle(name, coal.makeOctree(points, VOXEL_M), np.eye(4))


def table_obstacle(height_m: float = 0.0) -> Obstacle:
    """Everything below the table top."""
    return Obstacle("table", coal.Halfspace(np.array([0.0, 0.0, 1.0]), height_m), np.eye(4))


def convex_obstacle(name: str, vertices: np.ndarray, X_base_shape: np.ndarray) -> Obstacle:
    """The convex hull of vertices of shape (n, 3), given in the shape's own frame [m]."""
    points = coal.StdVec_Vec3s()
    for vertex in np.asarray(vertices, float):
        points.append(vertex)
    return Obstacle(name, coal.ConvexBase.convexHull(points, True, "Qt"), X_base_shape)
