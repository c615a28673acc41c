"""Any other object: flat pieces become plates, the rest is voxelised and split into convex pieces."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from s2r_host.model.carve import INTRUDES_M3, carved, corners, intrusion_m3
from s2r_host.model.decompose import decompose
from s2r_host.model.pieces import Piece, hull
from s2r_host.model.points import ObservedObject
from s2r_host.perception.motion import perpendicular_basis
from s2r_host.perception.planes import Plane, find_planes, fit_plane

Array = NDArray[np.floating]

PLATE_M = 0.008
VOXEL_M = 0.008
LEAST_FREE_POINTS = 400
CONVEX_SHARE = 0.85
CELL_M = 0.005
RIM_CELLS = 4  # empty cells around an outline: morphology takes what lies beyond the picture for filled


def part_pieces(
    seen: ObservedObject, rng: np.random.Generator, cpu_limit_s: float
) -> tuple[list[Piece], list[str]]:
    """Pieces of the moving part and warnings."""
    return _pieces("part", seen.part, seen.part_normals, seen, None, rng, cpu_limit_s)


def base_pieces(
    seen: ObservedObject, p_axis: Array, direction: Array, rng: np.random.Generator, cpu_limit_s: float
) -> tuple[list[Piece], list[str]]:
    """Pieces of the standing part: what is linked to the moving part, filled down to the support."""
    near = _near_part(seen)
    if near.sum() < 200:
        return [], ["nothing that stands still was seen beside the part; the base is empty"]
    return _pieces(
        "base", seen.rest[near], seen.rest_normals[near], seen, seen.support_height, rng, cpu_limit_s
    )


def _near_part(seen: ObservedObject) -> NDArray[np.bool_]:
    """Static points linked to the part's surroundings by 2 cm cells."""
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(seen.rest) == 0:
        return np.zeros(0, dtype=bool)
    cell, inverse = np.unique(np.floor(seen.rest / 0.02).astype(np.int64), axis=0, return_inverse=True)
    tree = cKDTree(cell.astype(np.float64))
    _, label = connected_components(
        tree.sparse_distance_matrix(tree, 1.8, output_type="coo_matrix"), directed=False
    )
    distance, _ = cKDTree(seen.part).query((cell + 0.5) * 0.02, distance_upper_bound=0.05)
    touching = np.isfinite(distance)
    if not touching.any():
        return np.zeros(len(seen.rest), dtype=bool)
    main = np.bincount(label[touching]).argmax()
    return (label == main)[inverse.ravel()]


def _pieces(
    body: Literal["base", "part"], points: Array, normals: Array, seen: ObservedObject, floor: float | None,
    rng: np.random.Generator, cpu_limit_s: float,
) -> tuple[list[Piece], list[str]]:  # fmt: skip
    chosen = rng.permutation(len(points))[:12000]
    p, n = points[chosen], normals[chosen]
    pieces: list[Piece] = []
    warnings: list[str] = []
    left = np.ones(len(p), dtype=bool)
    for k, plane in enumerate(find_planes(p, n, rng, most=4)):
        on = left & (np.abs((p - plane.centre) @ plane.normal) < 0.006)
        if on.sum() < 80:
            continue
        left &= ~on
        pieces += _plate(f"plate{k}", body, p[on], plane, seen, floor)
    left &= ~_inside(p, pieces)
    if left.sum() >= LEAST_FREE_POINTS:
        solid, warning = _thickened(p[left], seen), None
        if body == "base" and seen.p_camera is not None:
            hulls = [corners(solid)]
        else:
            hulls, warning = decompose(solid, VOXEL_M, cpu_limit_s)
        hulls = carved(hulls, solid, seen.empty[body], seen.up)
        pieces += [hull(f"free{k}", body, vertices) for k, vertices in enumerate(hulls)]
        warnings += [warning] if warning else []
    return pieces, warnings


def _plate(
    name: str,
    body: Literal["base", "part"],
    points: Array,
    plane: Plane,
    seen: ObservedObject,
    floor: float | None,
) -> list[Piece]:
    """Convex plates for one flat patch: its outline, extruded away from the camera (or down to the support)."""
    centre, normal = fit_plane(points)
    reference = seen.p_camera - centre if seen.p_camera is not None else seen.up
    if normal @ reference < 0:
        normal = -normal
    e1, e2 = perpendicular_basis(normal)
    flat = np.stack([(points - centre) @ e1, (points - centre) @ e2], axis=1)
    result = []
    for i, outline in enumerate(_outlines(flat)):
        top = centre + outline @ np.stack([e1, e2])
        solid = np.concatenate([top, top - PLATE_M * normal])
        if floor is not None and normal @ seen.up > 0.9:
            block = np.concatenate([top, top - ((top @ seen.up - floor)[:, None]) * seen.up])
            if (
                intrusion_m3(block, seen.empty[body]) < INTRUDES_M3
            ):  # else it hangs over what was seen below it
                solid = block
        result.append(hull(f"{name}_{i}", body, solid))
    return result


def _outlines(flat: Array) -> list[Array]:
    """Convex outlines that cover a flat point set: one if it is convex, else strips of a few centimetres."""
    low = flat.min(axis=0)
    cells = np.floor((flat - low) / CELL_M).astype(int) + RIM_CELLS
    image = np.zeros(cells.max(axis=0) + RIM_CELLS + 1, np.uint8)
    image[cells[:, 0], cells[:, 1]] = 1
    image = cv2.morphologyEx(image, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    image = cv2.morphologyEx(image, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(image, connectivity=4)
    found = []
    for k in range(1, count):
        if stats[k, cv2.CC_STAT_AREA] < 12:
            continue
        inside = np.argwhere(labels == k).astype(np.float64)
        corners = cv2.convexHull(inside.astype(np.float32))[:, 0].astype(np.float64)
        area = float(cv2.contourArea(corners.astype(np.float32)))
        if area < 1.0:
            continue
        if stats[k, cv2.CC_STAT_AREA] >= CONVEX_SHARE * area:
            found.append(corners)
            continue
        wide = int(np.argmax(np.ptp(inside, axis=0)))
        for start in np.arange(inside[:, wide].min(), inside[:, wide].max() + 1, 6):
            strip = inside[(inside[:, wide] >= start) & (inside[:, wide] <= start + 6)]
            if len(strip) >= 12 and np.ptp(strip, axis=0).min() >= 1:
                found.append(cv2.convexHull(strip.astype(np.float32))[:, 0].astype(np.float64))
    return [(corners - RIM_CELLS + 0.5) * CELL_M + low for corners in found]


def _inside(p: Array, pieces: list[Piece], margin_m: float = 0.006) -> NDArray[np.bool_]:
    """Points within a margin of any piece."""
    from scipy.spatial import ConvexHull

    covered = np.zeros(len(p), dtype=bool)
    for piece in pieces:
        local = (p - piece.X_base_piece[:3, 3]) @ piece.X_base_piece[:3, :3]
        equations = ConvexHull(piece.vertices).equations
        covered |= (local @ equations[:, :3].T + equations[:, 3] < margin_m).all(axis=1)
    return covered


def _thickened(p: Array, seen: ObservedObject) -> Array:
    """Points and a copy of them one plate further from the camera: a shell has no volume otherwise."""
    if seen.p_camera is None:
        away = np.broadcast_to(-seen.up, p.shape)
    else:
        ray = p - seen.p_camera
        away = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    return np.concatenate([p, p + 0.5 * PLATE_M * away, p + PLATE_M * away])
