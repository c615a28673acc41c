"""Which pixels of a depth frame show the arm itself, from its measured posture."""

from __future__ import annotations

from typing import Protocol

import coal
import numpy as np

from s2r_host.motion.arm_model import ArmModel
from s2r_host.perception.frames import backproject

INFLATION_M = 0.02


class DepthView(Protocol):
    """What is needed of a depth frame."""

    @property
    def depth_m(self) -> np.ndarray:
        """[m] along the optical axis, shape (h, w), 0 = nothing seen."""
        ...

    @property
    def K(self) -> np.ndarray:
        """Pinhole matrix, shape (3, 3)."""
        ...

    @property
    def X_base_camera(self) -> np.ndarray:
        """Pose of the OpenCV camera frame in the base frame, shape (4, 4)."""
        ...


def back_project(view: DepthView) -> np.ndarray:
    """Points in the base frame [m], shape (h, w, 3); rows without a return are NaN."""
    return backproject(view.depth_m, view.K, view.X_base_camera)


def robot_mask(
    arm: ArmModel, q_meas: np.ndarray, view: DepthView, inflation_m: float = INFLATION_M
) -> np.ndarray:
    """True where a pixel's point lies inside the arm's inflated shapes, shape (h, w), bool.

    Judged on the measured points instead of a rendered silhouette: a pixel that sees past the arm is kept.
    """
    p_base = back_project(view)
    mask = np.zeros(p_base.shape[:2], bool)
    flat = p_base.reshape(-1, 3)
    valid = np.flatnonzero(np.isfinite(flat[:, 0]))
    points = flat[valid]
    inside = np.zeros(len(points), bool)
    for shape, placement in zip(arm.shapes.geometryObjects, arm.shape_placements(q_meas), strict=True):
        reach = _radius(shape.geometry) + inflation_m
        near = np.flatnonzero(np.linalg.norm(points - placement.translation, axis=1) < reach)
        if len(near):
            local = (points[near] - placement.translation) @ placement.rotation
            inside[near] |= _distance(shape.geometry, local) < inflation_m
    mask.reshape(-1)[valid] = inside
    return mask


def _radius(shape: coal.CollisionGeometry) -> float:
    if isinstance(shape, coal.Sphere):
        return float(shape.radius)
    if isinstance(shape, coal.Box):
        return float(np.linalg.norm(shape.halfSide))
    if isinstance(shape, (coal.Cylinder, coal.Capsule)):
        return float(np.hypot(shape.radius, shape.halfLength + shape.radius))
    raise TypeError(f"arm shape {type(shape).__name__} is not one of Sphere, Box, Cylinder, Capsule")


def _distance(shape: coal.CollisionGeometry, local: np.ndarray) -> np.ndarray:
    """Distance of points in the shape's frame to its surface [m], 0 or less inside."""
    if isinstance(shape, coal.Sphere):
        return np.linalg.norm(local, axis=1) - shape.radius
    if isinstance(shape, coal.Box):
        return np.linalg.norm(np.maximum(np.abs(local) - shape.halfSide, 0.0), axis=1)
    radial = np.hypot(local[:, 0], local[:, 1]) - shape.radius
    axial = np.abs(local[:, 2]) - shape.halfLength
    if isinstance(shape, coal.Capsule):
        return np.hypot(radial + shape.radius, np.maximum(axial, 0.0)) - shape.radius
    return np.hypot(np.maximum(radial, 0.0), np.maximum(axial, 0.0))
