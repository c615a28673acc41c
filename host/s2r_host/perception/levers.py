"""Thin parts: the line of a lever before and after the motion, and the axes that carry one onto the other.

Stereo depth of a faucet's lever is a blob of a few hundred pixels without usable planes. What it does show is
a line, and the line of nearly every lever runs through its axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from s2r_host.perception.change import Change
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import perpendicular_basis, unit
from s2r_host.perception.view import View

Array = NDArray[np.floating]

LONG = 2.2  # length over width of what counts as a line
WIDEST_M = 0.05
NEAR_SIDE = 0.3  # of its width: how far the middle of the visible half of a round bar is from its axis
PIECE_M = 0.012
COLUMN_RADII_M = np.arange(0.008, 0.036, 0.002)
COLUMN_REACH_M = 0.09
CELL_M = 0.003
SAME_RADIUS_M = 0.002
LEAST_ROUND, ROUND_SHARE, ROUND_ARC_RAD = 40, 0.22, np.radians(45)  # points, of the walls around, seen of it


@dataclass(frozen=True, eq=False)
class Lever:
    """The line of a thin piece.

    Attributes:
        centre: Mean of its points [m], shape (3,).
        direction: Unit vector along it; its sign means nothing, shape (3,).
        length_m: Of the piece seen.
        width_m: Across the line.
    """

    centre: Array
    direction: Array
    length_m: float
    width_m: float

    def within(self, p_camera: Array | None) -> Lever:
        """The line inside of the bar: what a camera sees of a bar lies on its near side."""
        if p_camera is None:
            return self
        view = self.centre - p_camera
        away = view - (view @ self.direction) * self.direction
        return replace(self, centre=self.centre + NEAR_SIDE * self.width_m * unit(away))


@dataclass(frozen=True, eq=False)
class Column:
    """A line that some of the unmoved surface is round about.

    Attributes:
        centre: A point of it [m], (3,).
        direction: Unit vector, (3,).
        sure: Most of the surface around is that of one round body. Of 32 such lines on drawn faucets all but one were
            within 8 mm of the joint's axis or were another body's; of the others half were 10 to 20 mm off.
    """

    centre: Array
    direction: Array
    sure: bool


def lever(points: Array) -> Lever | None:
    """The line of the largest piece of some points (n, 3); None if it is no line."""
    if len(points) < 30:
        return None
    p = _largest_piece(points)
    if len(p) < 30:
        return None
    centre = p.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov((p - centre).T))
    spread = np.sqrt(np.maximum(values, 1e-12))
    length, width = 3.46 * float(spread[2]), 3.46 * float(spread[1])  # of a uniform bar
    if length < LONG * width or width > WIDEST_M:
        return None
    return Lever(centre, vectors[:, 2], length, width)


def line_within(points: Array, view: View) -> Lever | None:
    """The line of the largest piece of some points (n, 3) of a view, inside of the bar that shows them."""
    found = lever(points)
    return None if found is None else found.within(view.p_camera)


def line_pivots(a: Lever, b: Lever, direction: Array) -> list[Array]:
    """Points of axes along ``direction`` that turn one line onto the other.

    First where both lines cross when seen along the axis; then where the centre of one is carried onto the centre of
    the other by the angle between the lines (and by its complement, since a line has no sense).
    """
    e1, e2 = perpendicular_basis(direction)
    flat = np.stack([e1, e2])
    ca, cb, da, db = flat @ a.centre, flat @ b.centre, flat @ a.direction, flat @ b.direction
    height = 0.5 * float((a.centre + b.centre) @ direction)
    found = []
    sine = da[0] * db[1] - da[1] * db[0]
    scale = np.linalg.norm(da) * np.linalg.norm(db)
    if scale < 0.05:
        return []
    if abs(sine) > np.sin(np.radians(6)) * scale:
        t = ((cb - ca)[0] * db[1] - (cb - ca)[1] * db[0]) / sine
        found.append(ca + t * da)
    angle = float(np.arctan2(sine, da @ db))
    for theta in (angle, angle - np.sign(angle) * np.pi):
        if abs(theta) > np.radians(5):
            across = np.array([-(cb - ca)[1], (cb - ca)[0]])
            found.append(0.5 * (ca + cb) + 0.5 * across / np.tan(theta / 2))
    middle = 0.5 * (ca + cb)
    return [p @ flat + height * direction for p in found if np.linalg.norm(p - middle) < 0.35]


def columns(scene: Scene, direction: Array, near: Array, most: int = 3) -> list[Column]:
    """Axes along ``direction`` of round bodies beside the moved points: where normals of unmoved surface meet.

    Args:
        scene: Both views.
        direction: Of the axes, unit.
        near: Moved points [m], shape (n, 3).
        most: How many.
    """
    p, n = _around(scene.before, scene.changes.before == Change.STATIC, near)
    e1, e2 = perpendicular_basis(direction)
    flat = np.stack([e1, e2])
    across = n @ flat.T
    size = np.linalg.norm(across, axis=1)
    side = size > 0.7  # surfaces that run along the axis
    if side.sum() < 40:
        return []
    q, m = p[side] @ flat.T, across[side] / size[side, None]
    centres = (q[:, None] - COLUMN_RADII_M[None, :, None] * m[:, None]).reshape(-1, 2)
    low = centres.min(axis=0)
    cell = np.floor((centres - low) / CELL_M).astype(int)
    votes = np.zeros(cell.max(axis=0) + 1, np.float32)
    np.add.at(votes, (cell[:, 0], cell[:, 1]), 1.0)
    votes = cv2.GaussianBlur(votes, (0, 0), 1.0)
    height = float(np.median(near @ direction))
    found = []
    for _ in range(most):
        peak = np.array(np.unravel_index(int(votes.argmax()), votes.shape))
        centre = low + (peak + 0.5) * CELL_M
        found.append(Column(centre @ flat + height * direction, direction, _is_round(q - centre, m)))
        i, j = np.maximum(peak - 4, 0)
        votes[i : peak[0] + 5, j : peak[1] + 5] = 0.0
    return found


def _is_round(q: Array, m: Array) -> bool:
    """Whether the walls around a centre are mostly those of one round body, seen from enough sides.

    Args:
        q: Points of walls from the centre, seen along the axis [m], (n, 2).
        m: Their unit normals, (n, 2).
    """
    distance = np.linalg.norm(q, axis=1)
    radius = np.einsum("ni,ni->n", q, m)
    beside = np.abs(q[:, 0] * m[:, 1] - q[:, 1] * m[:, 0])
    fits = (beside < CELL_M) & (radius > COLUMN_RADII_M[0] - CELL_M) & (radius < COLUMN_RADII_M[-1] + CELL_M)
    if not fits.any():
        return False
    fits &= np.abs(distance - np.median(radius[fits])) < SAME_RADIUS_M
    around = (distance < COLUMN_RADII_M[-1] + 3 * CELL_M).sum()
    if fits.sum() < max(LEAST_ROUND, ROUND_SHARE * around):
        return False
    angle = np.arctan2(q[fits, 1], q[fits, 0])
    middle = np.angle(np.exp(1j * angle).mean())
    return bool(np.ptp(np.percentile(np.angle(np.exp(1j * (angle - middle))), [5, 95])) > ROUND_ARC_RAD)


def lever_directions(
    a: Lever | None, b: Lever | None, p_a: Array, p_b: Array, up: Array | None
) -> list[Array]:
    """Directions of axes that may have moved a thin part.

    Square to both lines, upright, and level and square to the way its middle went.

    Args:
        a, b: Its lines before and after, as far as they were seen.
        p_a, p_b: Middle of what left and of what appeared [m].
        up: Unit vector against gravity, None if unknown.
    """
    found = []
    if a is not None and b is not None:
        normal = np.cross(a.direction, b.direction)
        if np.linalg.norm(normal) > np.sin(np.radians(6)):
            found.append(unit(normal))
    if up is not None:
        found.append(up)
        level = np.cross(up, p_b - p_a)
        if np.linalg.norm(level) > 0.3 * np.linalg.norm(p_b - p_a):
            found.append(unit(level))
    return found


def bisector_pivots(line: Lever, p_a: Array, p_b: Array, direction: Array) -> list[Array]:
    """The point of a line that is as far from where the part was as from where it came, seen along the axis."""
    e1, e2 = perpendicular_basis(direction)
    flat = np.stack([e1, e2])
    c, d, way = flat @ line.centre, flat @ line.direction, flat @ (p_b - p_a)
    slope = float(d @ way)
    middle = 0.5 * flat @ (p_a + p_b)
    if abs(slope) < 0.1 * np.linalg.norm(way) * np.linalg.norm(d) or np.linalg.norm(way) < 0.003:
        return []
    p = c + float((middle - c) @ way) / slope * d
    if np.linalg.norm(p - middle) > 0.25:
        return []
    return [p @ flat + 0.5 * float((p_a + p_b) @ direction) * direction]


def _around(view: View, mask: NDArray[np.bool_], near: Array) -> tuple[Array, Array]:
    """Points and normals of the masked part of a view within reach of some points."""
    low, high = near.min(axis=0) - COLUMN_REACH_M, near.max(axis=0) + COLUMN_REACH_M
    inside = mask & view.normal_ok & ((view.points > low) & (view.points < high)).all(axis=1)
    index = np.flatnonzero(inside)[:: max(1, int(inside.sum()) // 4000)]
    return view.points[index], view.normals[index]


def _largest_piece(points: Array) -> Array:
    cell, inverse = np.unique(np.floor(points / PIECE_M).astype(np.int64), axis=0, return_inverse=True)
    tree = cKDTree(cell.astype(np.float64))
    _, label = connected_components(
        tree.sparse_distance_matrix(tree, 1.8, output_type="coo_matrix"), directed=False
    )
    of_point = label[inverse.ravel()]
    return points[of_point == np.bincount(of_point).argmax()]
