"""Any other object: flat pieces become plates, the rest is voxelised and split into convex pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from s2r_host.model.carve import INTRUDES_M3, carved, corners, intrusion_m3
from s2r_host.model.decompose import decompose
from s2r_host.model.pieces import Piece, hull, outside_m
from s2r_host.model.points import ObservedObject
from s2r_host.perception.motion import perpendicular_basis
from s2r_host.perception.planes import find_planes, fit_plane

Array = NDArray[np.floating]
Body = Literal["base", "part"]

PLATE_M = 0.008
LEAST_PLATE_M = 0.002
OTHER_FACE_COS = (
    -0.9
)  # between the outward normals of two patches, below it they may be the two faces of one plate
VOXEL_M = 0.008
MOST_POINTS = 12000
LEAST_FREE_POINTS, LEAST_APART_POINTS = 400, 100  # beside plates, from which on there is a piece of them
LEAST_STANDING = 200
BESIDE_M = 0.006  # a piece, from which on a point is not covered by it
OWN = 0  # the clump that the part sits on
CLUMP_CELL_M, LEAST_CELLS, LEAST_RISE_M, NEAR_PART_M = 0.02, 8, 0.02, 0.05
CONVEX_SHARE = 0.85
CELL_M = 0.005
RIM_CELLS = 4  # empty cells around an outline: morphology takes what lies beyond the picture for filled


def part_pieces(
    seen: ObservedObject, rng: np.random.Generator, cpu_limit_s: float
) -> tuple[list[Piece], list[str]]:
    """Pieces of the moving part and warnings."""
    chosen = rng.permutation(len(seen.part))[:MOST_POINTS]
    p = seen.part[chosen]
    pieces, on_plane = _plates("part", p, seen.part_normals[chosen], seen, None, rng)
    left = ~on_plane & (outside_m(p, pieces) >= BESIDE_M)
    if left.sum() < LEAST_FREE_POINTS:
        return pieces, []
    solid = _thickened(p[left], seen)
    hulls, warning = decompose(solid, VOXEL_M, cpu_limit_s)
    pieces += _free("part", hulls, solid, seen)
    return pieces, [warning] if warning else []


def base_pieces(
    seen: ObservedObject, rng: np.random.Generator, cpu_limit_s: float
) -> tuple[list[Piece], list[str]]:
    """Pieces of the standing part: all that stands about the moving part, filled down to the support.

    What is not linked to the rest, too: the part hides what joins a spout to its body, and whether that spout is the
    object's or another thing on the table, the arm must not run into it. Of such a clump all points count, also those
    of a plane whose outline is too thin for a plate; beside the part few points are as often the part's own.
    """
    clump = _clumps(seen)
    standing = np.flatnonzero(clump >= 0)
    if len(standing) < LEAST_STANDING:
        return [], ["nothing that stands still was seen beside the part; the base is empty"]
    chosen = standing[rng.permutation(len(standing))[:MOST_POINTS]]
    p, clump = seen.rest[chosen], clump[chosen]
    pieces, on_plane = _plates("base", p, seen.rest_normals[chosen], seen, seen.support_height, rng)
    left = outside_m(p, pieces) >= BESIDE_M
    clumps = [
        p[left & ~on_plane & (clump == OWN)],
        *(p[left & (clump == k)] for k in range(OWN + 1, clump.max() + 1)),
    ]
    least = (LEAST_FREE_POINTS, *(LEAST_APART_POINTS,) * (len(clumps) - 1))
    clumps = [one for one, points in zip(clumps, least, strict=True) if len(one) >= points]
    if not clumps:
        return pieces, []
    solids, warning = [_thickened(one, seen) for one in clumps], None
    solid = np.concatenate(solids)
    if seen.p_camera is not None:
        hulls = [corners(one) for one in solids]
    else:
        hulls, warning = decompose(solid, VOXEL_M, cpu_limit_s)
    pieces += _free("base", hulls, solid, seen)
    return pieces, [warning] if warning else []


def _clumps(seen: ObservedObject) -> NDArray[np.int64]:
    """Which clump of linked 2 cm cells each of the points that stand is of, (m,).

    0 is the one that the part sits on: the largest that comes near it. -1 are clumps too small for a thing that stands
    on a table, and those that hardly rise from it: wrong matches hang in the air, and tables are not quite flat.
    """
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(seen.rest) == 0:
        return np.zeros(0, dtype=np.int64)
    cells = np.floor(seen.rest / CLUMP_CELL_M).astype(np.int64)
    cell, inverse = np.unique(cells, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    tree = cKDTree(cell.astype(np.float64))
    pairs = tree.sparse_distance_matrix(tree, 1.8, output_type="coo_matrix")
    _, label = connected_components(pairs, directed=False)
    near_m, _ = cKDTree(seen.part).query((cell + 0.5) * CLUMP_CELL_M, distance_upper_bound=NEAR_PART_M)
    sizes = np.bincount(label)
    touching = np.bincount(label[np.isfinite(near_m)], minlength=len(sizes))
    height_m = seen.rest @ seen.up - seen.support_height
    rises = np.array([np.percentile(height_m[label[inverse] == k], 95) for k in range(len(sizes))])
    stands = (sizes >= LEAST_CELLS) & (rises > LEAST_RISE_M)
    number = np.full(len(sizes), -1)
    own = int(np.argmax(np.where(touching > 0, sizes, 0))) if touching.any() else -1
    others = [k for k in np.flatnonzero(stands) if k != own]
    number[others] = OWN + 1 + np.arange(len(others))
    if own >= 0:
        number[own] = OWN
    return number[label][inverse]


@dataclass(frozen=True, eq=False)
class _Patch:
    """Points (n, 3) of one flat patch, their middle (3,), and its normal towards who saw it (3,)."""

    points: Array
    centre: Array
    normal: Array

    @classmethod
    def of(cls, points: Array, normals: Array, seen: ObservedObject) -> _Patch:
        """Fit a patch to points, each with its normal towards the camera that saw it; without a camera it faces up."""
        centre, normal = fit_plane(points)
        reference = seen.up if seen.p_camera is None else normals.mean(axis=0)
        return cls(points, centre, normal if normal @ reference >= 0 else -normal)

    def thick_m(self, others: Sequence[_Patch]) -> float:
        """How thick its plate is [m]: up to the middle where the other face of it was seen, too."""
        behind = [
            -float(np.median((other.points - self.centre) @ self.normal))
            for other in others
            if other.normal @ self.normal < OTHER_FACE_COS
        ]
        return min([PLATE_M, *(max(LEAST_PLATE_M, 0.5 * depth) for depth in behind if depth > 0.0)])


def _plates(
    body: Body, p: Array, normals: Array, seen: ObservedObject, floor: float | None, rng: np.random.Generator
) -> tuple[list[Piece], NDArray[np.bool_]]:
    """Plates for the largest planes of points (n, 3), and which of the points lie on those planes, (n,)."""
    patches: list[_Patch] = []
    left = np.ones(len(p), dtype=bool)
    for plane in find_planes(p, normals, rng, most=4):
        on = left & (np.abs((p - plane.centre) @ plane.normal) < 0.006)
        if on.sum() < 80:
            continue
        left &= ~on
        patches.append(_Patch.of(p[on], normals[on], seen))
    pieces = []
    for k, patch in enumerate(patches):
        pieces += _plate(f"plate{k}", body, patch, patch.thick_m(patches), seen, floor)
    return pieces, ~left


def _free(body: Body, hulls: list[Array], solid: Array, seen: ObservedObject) -> list[Piece]:
    """Pieces of whatever shape, kept out of the space that was seen to be empty."""
    return [
        hull(f"free{k}", body, one) for k, one in enumerate(carved(hulls, solid, seen.empty[body], seen.up))
    ]


def _plate(
    name: str, body: Body, patch: _Patch, thick_m: float, seen: ObservedObject, floor: float | None
) -> list[Piece]:
    """Convex plates for one flat patch: its outline, extruded away from who saw it (or down to the support)."""
    centre, normal = patch.centre, patch.normal
    e1, e2 = perpendicular_basis(normal)
    flat = np.stack([(patch.points - centre) @ e1, (patch.points - centre) @ e2], axis=1)
    result = []
    for i, outline in enumerate(_outlines(flat)):
        top = centre + outline @ np.stack([e1, e2])
        solid = np.concatenate([top, top - thick_m * normal])
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


def _thickened(p: Array, seen: ObservedObject) -> Array:
    """Points and a copy of them one plate further from the camera: a shell has no volume otherwise."""
    if seen.p_camera is None:
        away = np.broadcast_to(-seen.up, p.shape)
    else:
        ray = p - seen.p_camera
        away = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    return np.concatenate([p, p + 0.5 * PLATE_M * away, p + PLATE_M * away])
