"""Finding the front of a drawer: the foremost large upright plane that faces the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from s2r_host.errors import SceneError
from s2r_host.motion.obstacles import voxels
from s2r_host.motion.scene import Scene

NORMAL_RADIUS_M = 0.015
CELL_M = 0.004
UPRIGHT_SIN = 0.34  # normals within 20 degrees of horizontal
FACING_COS = 0.5  # fronts turned up to 60 degrees away from the robot
PLANE_BAND_M = 0.006
MIN_AREA_M2 = 0.006
PROTRUSION_M = (0.008, 0.09)


@dataclass(frozen=True, eq=False)
class Front:
    """A flat front, in the base frame.

    Attributes:
        normal: Unit outward normal (towards the robot), shape (3,).
        offset_m: normal · p of its points.
        p_plane: Points on it [m], shape (n, 3).
        p_handle: Points that stand out of it (a handle), shape (m, 3), perhaps none.
        area_m2: Seen area.
    """

    normal: np.ndarray
    offset_m: float
    p_plane: np.ndarray
    p_handle: np.ndarray
    area_m2: float

    @property
    def across(self) -> np.ndarray:
        """Horizontal unit vector in the plane, shape (3,)."""
        vector = np.cross([0.0, 0.0, 1.0], self.normal)
        return vector / np.linalg.norm(vector)

    @property
    def upward(self) -> np.ndarray:
        """Unit vector in the plane that points up, shape (3,)."""
        return np.cross(self.normal, self.across)

    def in_plane(self, p_base: np.ndarray) -> np.ndarray:
        """(across, upward) coordinates of points [m], shape (n, 2)."""
        return np.stack([p_base @ self.across, p_base @ self.upward], axis=-1)

    def covers(self, p_base: np.ndarray, margin_m: float = 0.01) -> np.ndarray:
        """Which points lie before or behind the front's outline, widened by a margin; shape (n,), bool."""
        flat, outline = self.in_plane(p_base), self.in_plane(self.p_plane)
        low, high = np.percentile(outline, 1, axis=0), np.percentile(outline, 99, axis=0)
        return np.all((flat > low - margin_m) & (flat < high + margin_m), axis=1)


def find_front(scene: Scene) -> Front:
    """The foremost upright plane of at least 60 cm² that faces the robot.

    Raises:
        SceneError: There is none.
    """
    # Voxel centres are quantised; the plane fit uses the mean of the points in each voxel instead.
    points = _cell_means(scene.p_base, voxels(scene.p_base, CELL_M))
    normals = _normals(points, scene.p_camera)
    to_robot = -points[:, :2] / np.linalg.norm(points[:, :2], axis=1, keepdims=True)
    facing = (np.abs(normals[:, 2]) < UPRIGHT_SIN) & (
        np.einsum("ij,ij->i", normals[:, :2], to_robot) > FACING_COS
    )
    candidates = _planes(points, normals, facing)
    if not candidates:
        raise SceneError(
            f"no upright plane of at least {1e4 * MIN_AREA_M2:.0f} cm² faces the robot: {_what_faces(points[facing])}"
        )
    return min(candidates, key=lambda front: -front.offset_m)


def _what_faces(points: np.ndarray) -> str:
    """What was seen instead of a front, and what to do."""
    if not len(points):
        return "nothing that was seen does; is a drawer in view?"
    low, high = points[:, 2].min(), points[:, 2].max()
    return (
        f"{1e4 * len(points) * CELL_M**2:.0f} cm² of what was seen do, in smaller patches, {low:.2f} to {high:.2f} m "
        "over the base; if that is the front, half hidden: clear the camera's view of it"
    )


def _cell_means(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    nearest = cKDTree(centres).query(points)[1]
    counts = np.bincount(nearest, minlength=len(centres))
    sums = np.stack([np.bincount(nearest, points[:, i], len(centres)) for i in range(3)], axis=-1)
    return sums[counts > 0] / counts[counts > 0, None]


def _normals(points: np.ndarray, p_camera: np.ndarray) -> np.ndarray:
    """Unit normals towards the camera by local principal components, shape (n, 3)."""
    tree = cKDTree(points)
    neighbours = tree.query(points, k=min(30, len(points)), distance_upper_bound=NORMAL_RADIUS_M)[1]
    padded = np.vstack([points, np.full((1, 3), np.nan)])[neighbours]
    centred = padded - np.nanmean(padded, axis=1, keepdims=True)
    centred = np.nan_to_num(centred)
    covariance = np.einsum("nki,nkj->nij", centred, centred)
    normals = np.linalg.eigh(covariance)[1][:, :, 0]
    away = np.einsum("ij,ij->i", normals, p_camera - points) < 0.0
    normals[away] *= -1.0
    return normals


def _planes(points: np.ndarray, normals: np.ndarray, facing: np.ndarray) -> list[Front]:
    """Parallel layers along the dominant facing direction, each large enough, refined by least squares."""
    if facing.sum() < 50:
        return []
    normal = _dominant(normals[facing])
    found = []
    offsets = points[facing] @ normal
    left = np.ones(len(offsets), bool)
    while left.sum() > 50:
        centres = np.arange(offsets[left].min(), offsets[left].max() + 1e-3, 0.002)
        counts = np.array([(np.abs(offsets[left] - c) < PLANE_BAND_M).sum() for c in centres])
        best = centres[int(np.argmax(counts))]
        layer = left & (np.abs(offsets - best) < PLANE_BAND_M)
        area = _area(points[facing][layer], normal)
        if area < MIN_AREA_M2:
            break
        found.append(_refined(points, points[facing][layer], normal))
        left &= np.abs(offsets - best) > 2.0 * PLANE_BAND_M
    return found


def _dominant(normals: np.ndarray) -> np.ndarray:
    """The horizontal direction most normals agree with, refined by their mean."""
    flat = normals.copy()
    flat[:, 2] = 0.0
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    angles = np.arctan2(flat[:, 1], flat[:, 0])
    tries = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    votes = [(np.cos(angles - a) > np.cos(np.radians(8.0))).sum() for a in tries]
    best = tries[int(np.argmax(votes))]
    close = np.cos(angles - best) > np.cos(np.radians(12.0))
    mean = normals[close].mean(axis=0)
    return mean / np.linalg.norm(mean)


def _refined(points: np.ndarray, layer: np.ndarray, guess: np.ndarray) -> Front:
    normal, centre = guess, layer.mean(axis=0)
    for _ in range(3):
        near = layer[np.abs((layer - centre) @ normal) < 0.5 * PLANE_BAND_M]
        if len(near) < 30:
            break
        centre = near.mean(axis=0)
        axis = np.linalg.svd(near - centre, full_matrices=False)[2][2]
        normal = axis if axis @ guess > 0.0 else -axis
    height = (points - centre) @ normal
    inside = _inside_outline(points, layer, normal, centre)
    out = inside & (height > PROTRUSION_M[0]) & (height < PROTRUSION_M[1])
    return Front(normal, float(centre @ normal), layer, points[out], _area(layer, normal))


def _inside_outline(
    points: np.ndarray, layer: np.ndarray, normal: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    return Front(normal, float(centre @ normal), layer, layer[:0], 0.0).covers(points, 0.02)


def _area(points: np.ndarray, normal: np.ndarray) -> float:
    flat = Front(normal, 0.0, points, points[:0], 0.0).in_plane(points)
    cell = 2.0 * CELL_M
    return len(np.unique(np.floor(flat / cell).astype(int), axis=0)) * cell * cell
