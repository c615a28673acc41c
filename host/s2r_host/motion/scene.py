"""The observed scene: object points above the table, the arm's own pixels left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from s2r_host.errors import EmptyCloudError
from s2r_host.motion.robot_mask import DepthView, back_project

MIN_POINTS = 500
CELL_M = 0.01
MIN_CELLS = 25
# Stereo cameras filter wrong matches by size: of 18 000 small clumps in 120 drawn views, four fifths of them wrong, one
# had 50 points or more. The end of a lever that points at the camera has 300 to 600, in 8 to 20 cells.
DENSE_POINTS = 150


@dataclass(frozen=True)
class Region:
    """Box of the base frame in which the object is looked for [m]."""

    x_m: tuple[float, float] = (0.2, 1.3)
    y_m: tuple[float, float] = (-0.7, 0.7)
    z_m: tuple[float, float] = (0.008, 0.9)

    def contains(self, p_base: np.ndarray) -> np.ndarray:
        """Bool of shape (...,) for points of shape (..., 3); NaN is outside."""
        spans = (self.x_m, self.y_m, self.z_m)
        inside = [(p_base[..., i] > low) & (p_base[..., i] < high) for i, (low, high) in enumerate(spans)]
        return np.logical_and.reduce(inside)


@dataclass(frozen=True, eq=False)
class Scene:
    """Object points in the base frame [m], shape (n, 3), and where they were seen from, shape (3,)."""

    p_base: np.ndarray
    p_camera: np.ndarray


def observed_scene(
    view: DepthView, arm_mask: np.ndarray | None = None, region: Region | None = None
) -> Scene:
    """Points of the object, seen in one frame.

    Raises:
        EmptyCloudError: Fewer than 500 points lie in the region.
    """
    region = region or Region()
    p_base = back_project(view)
    keep = region.contains(p_base)
    if arm_mask is not None:
        keep &= ~arm_mask
    points = without_specks(p_base[keep])
    count = len(points)
    if count < MIN_POINTS:
        seen = int(np.isfinite(p_base[..., 0]).sum())
        raise EmptyCloudError(
            f"depth frame shows {count} points of an object (needs {MIN_POINTS}) in x {region.x_m}, y {region.y_m}, "
            f"z {region.z_m} m; {seen} of {p_base.shape[0] * p_base.shape[1]} pixels have depth at all. "
            "Is the object in view and the camera calibrated?"
        )
    return Scene(points, np.asarray(view.X_base_camera)[:3, 3].copy())


def without_specks(p_base: np.ndarray) -> np.ndarray:
    """Leave out small clumps that hang in the air: wrong stereo matches that would block the arm's way.

    Args:
        p_base: Points [m], shape (n, 3).

    Returns:
        Points whose 1 cm cells belong to a connected clump of at least 25 cells or 150 points, shape (m, 3).
    """
    if not len(p_base):
        return p_base
    cells = np.floor(p_base / CELL_M).astype(np.int64)
    cells -= cells.min(axis=0)
    grid = np.zeros(cells.max(axis=0) + 1, bool)
    grid[tuple(cells.T)] = True
    labels = np.zeros(grid.shape, np.int32)
    ndimage.label(grid, structure=np.ones((3, 3, 3)), output=labels)
    of = labels[tuple(cells.T)]
    kept = (np.bincount(labels.ravel()) >= MIN_CELLS) | (
        np.bincount(of, minlength=int(labels.max()) + 1) >= DENSE_POINTS
    )
    return p_base[kept[of]]
