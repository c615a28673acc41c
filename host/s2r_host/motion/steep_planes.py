"""Planes of a view that are not level, by Open3D's RANSAC. A module of its own: Open3D takes a second to load."""

from __future__ import annotations

import numpy as np
import open3d as o3d

FLAT_COS = 0.95  # planes nearer to level than 18 degrees are the base or the table
BAND_M = 0.005
PLANES = 4


def steep_planes(p_base: np.ndarray, cell_m: float, least_m2: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """Points thinned to one per cell, and masks of the largest planes among them that are not level, largest first.

    Args:
        p_base: Points, z up [m], shape (n, 3).
        cell_m: Edge of a cell [m].
        least_m2: Smaller planes are not looked for.
    """
    cloud = _cloud(p_base).voxel_down_sample(cell_m)
    points = np.asarray(cloud.points)
    o3d.utility.random.seed(0)
    left = np.ones(len(points), bool)
    found: list[np.ndarray] = []
    for _ in range(PLANES):
        index = np.flatnonzero(left)
        if len(index) * cell_m**2 < least_m2:
            break
        (a, b, c, _), inliers = _cloud(points[index]).segment_plane(BAND_M, ransac_n=3, num_iterations=1000)
        members = index[np.asarray(inliers, int)]
        left[members] = False
        if len(members) * cell_m**2 < least_m2:
            break
        if abs(c) / np.linalg.norm([a, b, c]) < FLAT_COS:
            mask = np.zeros(len(points), bool)
            mask[members] = True
            found.append(mask)
    return points, sorted(found, key=lambda mask: -int(mask.sum()))


def _cloud(points: np.ndarray) -> o3d.geometry.PointCloud:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
