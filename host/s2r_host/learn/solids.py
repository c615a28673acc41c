"""Which points lie inside exact solids: the truth of the occupancy that the pair network learns.

Rows of solids are those of ``s2r data pairs``: number of the shape as MuJoCo counts, three sizes [m], pose (3, 4).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX = 2, 3, 4, 5, 6
COLUMNS = 16


def inside(points: Array, solids: Array) -> NDArray[np.bool_]:
    """Points [m] (n, 3) within any of the solids (m, `COLUMNS`), shape (n,).

    Raises:
        ValueError: A shape that is none of the above, a mesh for example.
    """
    found = np.zeros(len(points), dtype=bool)
    for row in solids:
        pose = row[4:].reshape(3, 4)
        found |= _inside_one((points - pose[:, 3]) @ pose[:, :3], int(row[0]), row[1:4])
    return found


def moved(solids: Array, X: Array) -> Array:
    """The solids carried by X (4, 4)."""
    out = np.array(solids, dtype=float)
    for row in out:
        pose = row[4:].reshape(3, 4)
        row[4:] = (X[:3, :3] @ pose + np.c_[np.zeros((3, 3)), X[:3, 3]]).ravel()
    return out


def drawn_around(solids: Array, count: int, margin_m: float, rng: np.random.Generator) -> Array:
    """Random points in the boxes around the solids, each box grown by ``margin_m`` on all sides, (count, 3)."""
    half = np.stack([_half(int(row[0]), row[1:4]) for row in solids]) + margin_m
    of = rng.choice(len(solids), count, p=half.prod(axis=1) / half.prod(axis=1).sum())
    local = rng.uniform(-1, 1, (count, 3)) * half[of]
    pose = solids[of, 4:].reshape(-1, 3, 4)
    return np.einsum("nij,nj->ni", pose[:, :, :3], local) + pose[:, :, 3]


def _half(shape: int, size: Array) -> Array:
    """Half of the sides of the box around a solid in its own frame."""
    if shape == SPHERE:
        return np.full(3, size[0])
    if shape in (CAPSULE, CYLINDER):
        return np.array([size[0], size[0], size[1] + (size[0] if shape == CAPSULE else 0.0)])
    return np.array(size, dtype=float)


def _inside_one(p: Array, shape: int, size: Array) -> NDArray[np.bool_]:
    if shape == BOX:
        return np.all(np.abs(p) <= size, axis=1)
    if shape == SPHERE:
        return np.linalg.norm(p, axis=1) <= size[0]
    if shape == ELLIPSOID:
        return np.linalg.norm(p / size, axis=1) <= 1.0
    if shape == CYLINDER:
        return (np.hypot(p[:, 0], p[:, 1]) <= size[0]) & (np.abs(p[:, 2]) <= size[1])
    if shape == CAPSULE:
        beyond = np.maximum(np.abs(p[:, 2]) - size[1], 0.0)
        return np.linalg.norm(np.column_stack([p[:, :2], beyond]), axis=1) <= size[0]
    raise ValueError(f"solid of shape {shape}; known are sphere, capsule, ellipsoid, cylinder, box (2 to 6)")
