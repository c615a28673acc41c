"""Meshes as closed solids, for what they weigh: the data sets' meshes are open, doubled and pass through each other.

A solid serves the inertia alone. What the camera sees and the finger touches stays the mesh of the file: a cabinet
whose open front were closed would hide its drawers.
"""

from __future__ import annotations

import manifold3d
import numpy as np

WELD = 1e-6  # of the mesh's size: vertices nearer to each other are one
LEAST_SHARE = 1e-6  # of its convex hull's volume: a solid with less has faces that cancel each other


def closed(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The solid within a mesh: holes are closed over their rims, what overlaps counts once.

    Args:
        points: Vertices [m], shape (n, 3).
        triangles: Their numbers, shape (m, 3); which way round they go does not matter.

    Returns:
        Vertices [m] and triangles of a closed surface that faces outwards; None where the mesh bounds no solid: three
        faces at one edge, a rim that forks, faces that cancel each other.
    """
    points, triangles = _welded(points, triangles)
    triangles = _without_rims(points, _oriented(triangles))
    pieces = []
    for piece in _connected(triangles):
        if _volume(points, piece) < 0:
            piece = piece[:, ::-1]
        solid = manifold3d.Manifold(
            manifold3d.Mesh64(np.ascontiguousarray(points), np.ascontiguousarray(piece, dtype=np.uint64))
        )
        if solid.status() != manifold3d.Error.NoError:
            return None
        pieces.append(solid)
    whole = manifold3d.Manifold.batch_boolean(pieces, manifold3d.OpType.Add)
    hull = manifold3d.Manifold.hull_points(points)
    if whole.is_empty() or not LEAST_SHARE * hull.volume() < whole.volume() <= 1.001 * hull.volume():
        return None
    mesh = whole.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)


def hulled(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of the convex hull of points (n, 3) that do not lie in one plane."""
    mesh = manifold3d.Manifold.hull_points(points).to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)


def _welded(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """With one vertex per place and each face once, whichever way round it goes."""
    cell = WELD * float(np.ptp(points, axis=0).max())
    _, first, number = np.unique(np.round(points / cell), axis=0, return_index=True, return_inverse=True)
    triangles = number.reshape(-1)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    _, once = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return points[first], triangles[np.sort(once)]


def _edges(triangles: np.ndarray) -> dict[tuple[int, int], list[int]]:
    """Numbers of the triangles at each edge, whichever way it is gone along."""
    found: dict[tuple[int, int], list[int]] = {}
    for k, (a, b, c) in enumerate(triangles.tolist()):
        for p, q in ((a, b), (b, c), (c, a)):
            found.setdefault((min(p, q), max(p, q)), []).append(k)
    return found


def _oriented(triangles: np.ndarray) -> np.ndarray:
    """The triangles turned so that neighbours go the same way round, as far as two meet at each edge."""
    edges, result = _edges(triangles), triangles.copy()
    done = np.zeros(len(triangles), dtype=bool)
    for start in range(len(triangles)):
        waiting = [] if done[start] else [start]
        done[start] = True
        while waiting:
            k = waiting.pop()
            a, b, c = result[k].tolist()
            for p, q in ((a, b), (b, c), (c, a)):
                at = edges[(min(p, q), max(p, q))]
                for other in at if len(at) == 2 else ():
                    if done[other]:
                        continue
                    done[other] = True
                    x, y, z = result[other].tolist()
                    if (p, q) in ((x, y), (y, z), (z, x)):
                        result[other] = x, z, y
                    waiting.append(other)
    return result


def _without_rims(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """With triangles over every rim that is one loop; one that forks is left open."""
    there = {edge for a, b, c in triangles.tolist() for edge in ((a, b), (b, c), (c, a))}
    after = {b: a for a, b in there if (b, a) not in there}
    lids = [triangles]
    left = set(after)
    while left:
        start = min(left)
        loop, k = [], start
        while k in left:
            left.remove(k)
            loop.append(k)
            k = after[k]
        if k == start and len(loop) >= 3:
            lids.append(_lid(points, np.array(loop)))
    return np.concatenate(lids)


def _lid(points: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Triangles over a loop of vertices, the way round it goes, as they lie in its main plane."""
    corners = points[loop] - points[loop].mean(axis=0)
    plane = np.linalg.svd(corners, full_matrices=False)[2][:2]
    x, y = plane @ corners.T
    if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0:
        x = -x
    return loop[np.asarray(manifold3d.triangulate([np.stack([x, y], axis=1)]), dtype=np.int64)]


def _connected(triangles: np.ndarray) -> list[np.ndarray]:
    """The triangles by pieces that hang together over edges."""
    label = np.full(len(triangles), -1)
    edges = _edges(triangles)
    count = 0
    for start in range(len(triangles)):
        if label[start] >= 0:
            continue
        label[start], waiting = count, [start]
        while waiting:
            a, b, c = triangles[waiting.pop()].tolist()
            for p, q in ((a, b), (b, c), (c, a)):
                for other in edges[(min(p, q), max(p, q))]:
                    if label[other] < 0:
                        label[other] = count
                        waiting.append(other)
        count += 1
    return [triangles[label == k] for k in range(count)]


def _volume(points: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = np.swapaxes(points[triangles] - points.mean(axis=0), 0, 1)
    return float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6)
