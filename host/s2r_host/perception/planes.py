"""Flat pieces of a point set: planes, their outlines and the lines where they cross."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.motion import perpendicular_basis, unit

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Plane:
    """A flat piece.

    Attributes:
        centre: Mean of its points [m], shape (3,).
        normal: Unit normal, shape (3,).
        size: Number of points.
        edge_directions: The two directions of its tightest rectangle, shape (2, 3).
        corners: Corners of that rectangle in order [m], shape (4, 3).
    """

    centre: Array
    normal: Array
    size: int
    edge_directions: Array
    corners: Array


def find_planes(
    points: Array, normals: Array, rng: np.random.Generator, most: int = 5, inlier_m: float = 0.004
) -> list[Plane]:
    """Largest planes first, each with at least 4 % of the points (and 40 points)."""
    left = np.arange(len(points))
    fewest = max(40, int(0.04 * len(points)))
    planes: list[Plane] = []
    while len(planes) < most and len(left) >= fewest:
        p, n = points[left], normals[left]
        best = _best_seed(p, n, rng, inlier_m)
        if best.sum() < fewest:
            break
        for _ in range(2):
            if best.sum() < fewest:
                break
            centre, normal = fit_plane(p[best])
            best = _inliers(p, n, centre, normal, inlier_m)
        if best.sum() < fewest:
            break
        centre, normal = fit_plane(p[best])
        planes.append(_with_outline(p[best], centre, normal))
        left = left[~best]
    return planes


def fit_plane(points: Array) -> tuple[Array, Array]:
    """Centre and unit normal of the least-squares plane through points (n, 3)."""
    centre = points.mean(axis=0)
    _, vectors = np.linalg.eigh((points - centre).T @ (points - centre))
    return centre, vectors[:, 0]


def crossing_line(a: Plane, b: Plane) -> tuple[Array, Array] | None:
    """Point nearest to both centres and direction of the line where two planes cross; None below 3 degrees."""
    direction = np.cross(a.normal, b.normal)
    sine = float(np.linalg.norm(direction))
    if sine < np.sin(np.radians(3.0)):
        return None
    direction = direction / sine
    middle = 0.5 * (a.centre + b.centre)
    matrix = np.stack([a.normal, b.normal, direction])
    point = np.linalg.solve(matrix, [a.normal @ a.centre, b.normal @ b.centre, direction @ middle])
    return point, direction


def _best_seed(p: Array, n: Array, rng: np.random.Generator, inlier_m: float) -> NDArray[np.bool_]:
    sample = rng.permutation(len(p))[:600]
    seeds = rng.permutation(len(p))[:150]
    offset = np.abs(
        np.einsum("sk,nk->sn", n[seeds], p[sample]) - np.einsum("sk,sk->s", n[seeds], p[seeds])[:, None]
    )
    aligned = np.abs(n[seeds] @ n[sample].T) > np.cos(np.radians(15))
    best = int(np.argmax(((offset < 2 * inlier_m) & aligned).sum(axis=1)))
    return _inliers(p, n, p[seeds[best]], n[seeds[best]], 2 * inlier_m)


def _inliers(p: Array, n: Array, centre: Array, normal: Array, inlier_m: float) -> NDArray[np.bool_]:
    return (np.abs((p - centre) @ normal) < inlier_m) & (np.abs(n @ normal) > np.cos(np.radians(20)))


def _with_outline(points: Array, centre: Array, normal: Array) -> Plane:
    e1, e2 = perpendicular_basis(normal)
    flat = np.stack([(points - centre) @ e1, (points - centre) @ e2], axis=1)
    low, high = np.percentile(flat, [1, 99], axis=0)
    core = flat[((flat >= low) & (flat <= high)).all(axis=1)]
    corners2 = cv2.boxPoints(cv2.minAreaRect(core.astype(np.float32))).astype(np.float64)
    corners = centre + corners2 @ np.stack([e1, e2])
    edges = [corners[1] - corners[0], corners[2] - corners[1]]
    directions = np.stack([unit(e) if np.linalg.norm(e) > 1e-6 else e1 for e in edges])
    return Plane(centre, normal, len(points), directions, corners)
