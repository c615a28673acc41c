"""Depth views: an organised depth image of one camera, or a bare point cloud.

Frames: "base" is one fixed frame with z up, "camera" the OpenCV camera frame (x right, y down, z forward).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.view_checks import (
    check_colour,
    check_depth,
    check_pinhole,
    check_points,
    check_pose,
)

FloatArray = NDArray[np.floating]

LEAST_AHEAD_M = 1e-3  # of the camera, for a point to have a pixel


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """One depth image and the camera that took it.

    Attributes:
        depth_m: Depth along the optical axis [m], shape (h, w); 0 = no return.
        K: Pinhole matrix [px], shape (3, 3).
        X_base_camera: Pose of the OpenCV camera frame in the base frame, shape (4, 4).
        colour: RGB, uint8, shape (h, w, 3), or None.
    """

    depth_m: NDArray[np.float32]
    K: NDArray[np.floating]
    X_base_camera: NDArray[np.floating]
    colour: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        check_depth(self.depth_m)
        check_pinhole(self.K)
        check_pose(self.X_base_camera)
        if self.colour is not None:
            check_colour(self.colour, self.depth_m.shape)

    def points_base(self) -> NDArray[np.floating]:
        """Every pixel as a point in the base frame [m], shape (h, w, 3); NaN where there is no return."""
        return backproject(self.depth_m, self.K, self.X_base_camera)


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud without an image grid.

    Attributes:
        points: Points [m], shape (n, 3).
        p_camera: Where the camera stood, in the same frame, shape (3,), or None if unknown (then nothing is
            known about free space).
        colour: RGB, uint8, shape (n, 3), or None.
    """

    points: NDArray[np.floating]
    p_camera: NDArray[np.floating] | None = None
    colour: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        check_points(self.points)


def backproject(
    depth_m: FloatArray, K: NDArray[np.floating], X_base_camera: NDArray[np.floating]
) -> NDArray[np.floating]:
    """Points of all pixels in the base frame [m], shape (h, w, 3); NaN where depth is 0."""
    h, w = depth_m.shape
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    z = np.where(depth_m > 0, depth_m, np.nan).astype(np.float64)
    p_C = pixel_rays(K, u, v) * z[..., None]
    return p_C @ X_base_camera[:3, :3].T + X_base_camera[:3, 3]


def pixel_rays(
    K: NDArray[np.floating], u: NDArray[np.generic], v: NDArray[np.generic]
) -> NDArray[np.floating]:
    """Where pixels look, in the OpenCV camera frame, with z = 1: times depth it is a point. Shape (..., 3)."""
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def project(
    p: NDArray[np.floating], K: NDArray[np.floating], X_base_camera: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Where points show in a camera's image: the inverse of :func:`backproject`.

    Args:
        p: In the base frame [m], shape (..., 3).
        K: Pinhole matrix, shape (3, 3).
        X_base_camera: Pose of the OpenCV camera frame in the base frame, shape (4, 4).

    Returns:
        Pixels (u right, v down; 0, 0 is the middle of the first), shape (..., 2), NaN for points that are not in front
        of the camera, and depths along the optical axis [m], shape (...).
    """
    p_C = (p - X_base_camera[:3, 3]) @ X_base_camera[:3, :3]
    z = p_C[..., 2]
    ahead = np.where(z > LEAST_AHEAD_M, z, np.nan)[..., None]
    return p_C[..., :2] / ahead * [K[0, 0], K[1, 1]] + K[:2, 2], z
