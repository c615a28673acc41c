"""Hulls that reach into space the camera saw to be empty are split until they hardly do.

A convex piece bridges every hollow of what it covers. Where the camera looked through such a hollow, nothing is
there, and a fingertip may go there: between a lever and the spout beside it, under a bar, beside a hub.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from s2r_host.perception.motion import perpendicular_basis

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Free = Callable[[Array], Mask]
"""Which of some points (n, 3) the camera saw to be empty."""

INTRUDES_M3 = 4e-6  # of empty space inside one piece: a cube of 16 mm, narrower than a fingertip
MUCH = 5.0  # so many times that: cut in any case, a later cut will help
SAMPLES = 1500  # points looked at per piece
LEAST_POINTS = 12
MOST_PIECES = 40
CUTS = (0.25, 0.4, 0.5, 0.6, 0.75)  # of the width, where a piece may be cut


def carved(hulls: list[Array], points: Array, free: Free, up: Array) -> list[Array]:
    """Hulls of the same points with less empty space inside.

    Args:
        hulls: Corner sets (k, 3) [m].
        points: Points of the solid they cover [m], (n, 3).
        free: What was seen to be empty.
        up: Unit vector, (3,); cuts are level, or upright along the two main directions of what is cut.

    Returns:
        Corner sets: those without much empty space as they were, the others' points in several hulls. Beyond
        ``MOST_PIECES`` in all, the worst that are left stay as they are.
    """
    done: list[Array] = []
    todo = [(intrusion_m3(one, free), one) for one in hulls]
    while todo:
        worst = max(range(len(todo)), key=lambda k: todo[k][0])
        intrudes, one = todo.pop(worst)
        own = points[_inside(one, points)]
        halves = None
        if (
            intrudes > INTRUDES_M3
            and len(done) + len(todo) + 2 <= MOST_PIECES
            and len(own) >= 2 * LEAST_POINTS
        ):
            halves = _halves(own, free, up, intrudes)
        if halves is None:
            done.append(one)
        else:
            todo += [(intrusion_m3(half, free), half) for half in halves]
    return done


def intrusion_m3(hull_corners: Array, free: Free) -> float:
    """How much of the space inside a hull was seen to be empty [m³]."""
    hull = ConvexHull(hull_corners)
    low, high = hull_corners.min(axis=0), hull_corners.max(axis=0)
    cell = (float(np.prod(high - low)) / SAMPLES) ** (1 / 3)
    axes = [np.arange(low[k] + cell / 2, high[k], cell) for k in range(3)]
    p = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    p = p[(p @ hull.equations[:, :3].T + hull.equations[:, 3] < 0.0).all(axis=1)]
    return float(hull.volume) * float(free(p).mean()) if len(p) else 0.0


def corners(points: Array) -> Array:
    """Corners of the convex hull of points (n, 3), (k, 3).

    Raises:
        QhullError: Too few points, or all in a plane.
    """
    if len(points) < LEAST_POINTS:
        raise QhullError("too few points")
    return points[ConvexHull(points).vertices]


def _halves(points: Array, free: Free, up: Array, intrudes: float) -> tuple[Array, Array] | None:
    """The cut that leaves least empty space inside; None if no cut takes a tenth of little empty space away."""
    best: tuple[float, tuple[Array, Array]] | None = None
    for axis, share in product(_directions(points, up), CUTS):
        t = points @ axis
        low, high = float(t.min()), float(t.max())
        below = t < low + share * (high - low)
        try:
            halves = corners(points[below]), corners(points[~below])
        except QhullError:
            continue  # a half is flat
        left = sum(intrusion_m3(half, free) for half in halves)
        if best is None or left < best[0]:
            best = left, halves
    if best is None or (best[0] > 0.9 * intrudes and intrudes < MUCH * INTRUDES_M3):
        return None
    return best[1]


def _directions(points: Array, up: Array) -> list[Array]:
    """Up, and the two main level directions of some points."""
    e1, e2 = perpendicular_basis(up)
    level = np.stack([points @ e1, points @ e2], axis=1)
    vectors = np.linalg.eigh(np.cov(level.T))[1]
    return [up, *(vectors[0, k] * e1 + vectors[1, k] * e2 for k in (0, 1))]


def _inside(hull_corners: Array, points: Array, margin_m: float = 1e-4) -> Mask:
    equations = ConvexHull(hull_corners).equations
    return np.asarray((points @ equations[:, :3].T + equations[:, 3] < margin_m).all(axis=1))
