"""Depth views: an organised depth image of one camera, or a bare point cloud.

Frames: "base" is one fixed frame with z up, "camera" the OpenCV camera frame (x right, y down, z forward).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import BadViewError

FloatArray = NDArray[np.floating]

NEAREST_M = 0.05
FARTHEST_M = 20.0
FEWEST_POINTS = 200
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
        _check_depth(self.depth_m)
        _check_camera(self.K, self.X_base_camera, self.depth_m.shape)
        if self.colour is not None:
            _check_colour(self.colour, self.depth_m.shape)

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
        _check_points(self.points)


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


def _check_depth(depth_m: FloatArray) -> None:
    if depth_m.ndim != 2 or depth_m.size == 0:
        raise BadViewError(f"depth has shape {depth_m.shape}; expected a (height, width) image in metres")
    if not np.isfinite(depth_m).all():
        bad = int((~np.isfinite(depth_m)).sum())
        raise BadViewError(
            f"depth holds {bad} values that are not finite; write 0 where the camera has no return"
        )
    valid = depth_m[depth_m != 0]
    if valid.size < FEWEST_POINTS:
        raise BadViewError(
            f"depth holds {valid.size} returns, at least {FEWEST_POINTS} are needed; is the view empty?"
        )
    _check_range("depth", valid)


def _check_colour(colour: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if colour.shape != (*shape, 3) or colour.dtype != np.uint8:
        raise BadViewError(
            f"colour is {colour.dtype} with shape {colour.shape}; expected uint8 with shape {(*shape, 3)},"
            " a colour per pixel of the depth: convert it, or leave it out"
        )


def _check_range(what: str, distance_m: FloatArray) -> None:
    if distance_m.min() < 0:
        raise BadViewError(f"{what} holds negative values (least {distance_m.min():.3g} m)")
    median = float(np.median(distance_m))
    if median > FARTHEST_M:
        raise BadViewError(
            f"{what} has a median of {median:.4g} m, beyond {FARTHEST_M:g} m: these look like millimetres;"
            " give metres"
        )
    if median < NEAREST_M:
        raise BadViewError(
            f"{what} has a median of {median:.3g} m, nearer than {NEAREST_M:g} m; give metres, not kilometres"
        )


def _check_camera(
    K: NDArray[np.floating], X_base_camera: NDArray[np.floating], shape: tuple[int, ...]
) -> None:
    if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise BadViewError(
            "K must be a finite 3x3 pinhole matrix with positive focal lengths in pixels, got\n" + str(K)
        )
    if np.abs(K[2] - (0.0, 0.0, 1.0)).max() > 1e-6 or abs(K[1, 0]) > 1e-6:
        raise BadViewError(
            f"K must end in the row 0 0 1 and have no skew below its diagonal, got\n{K}\nis it transposed (column by"
            " column)?"
        )
    h, w = shape
    if not (-w < K[0, 2] < 2 * w and -h < K[1, 2] < 2 * h):
        raise BadViewError(
            f"principal point ({K[0, 2]:.1f}, {K[1, 2]:.1f}) px does not belong to a {w}x{h} image;"
            " are the intrinsics of another resolution?"
        )
    if X_base_camera.shape != (4, 4) or not np.isfinite(X_base_camera).all():
        raise BadViewError("T_base_camera must be a finite 4x4 matrix")
    if np.abs(X_base_camera[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
        raise BadViewError(
            f"T_base_camera must end in the row 0 0 0 1, got\n{X_base_camera}\nis it transposed (column by column)?"
        )
    R = X_base_camera[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise BadViewError(
            "the rotation in T_base_camera is not a rotation matrix"
            f" (|R Rᵀ - 1| = {np.abs(R @ R.T - np.eye(3)).max():.3g}, det {np.linalg.det(R):.3f})"
        )
    if np.abs(X_base_camera[:3, 3]).max() > FARTHEST_M:
        raise BadViewError(
            f"T_base_camera puts the camera {np.abs(X_base_camera[:3, 3]).max():.4g} m away; give metres"
        )


def _check_points(points: NDArray[np.floating]) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise BadViewError(f"a cloud has shape (points, 3), got {points.shape}")
    if len(points) < FEWEST_POINTS:
        raise BadViewError(f"the cloud holds {len(points)} points, at least {FEWEST_POINTS} are needed")
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points).all(axis=1)).sum())
        raise BadViewError(f"the cloud holds {bad} points that are not finite; drop them before writing")
    extent = np.ptp(np.percentile(points, [5, 95], axis=0), axis=0)
    if extent.max() > FARTHEST_M:
        raise BadViewError(
            f"the cloud spans {extent.max():.4g} m, beyond {FARTHEST_M:g} m: these look like millimetres;"
            " give metres"
        )
    if extent.max() < 0.01:
        raise BadViewError(f"the cloud spans only {extent.max() * 1e3:.3g} mm; give metres")
