"""Convex pieces: what an object model is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Piece:
    """One convex solid in the frame of the views, in the pose of the first view.

    Attributes:
        name: Without the body prefix, e.g. "front" (geom "part_front").
        body: "base" (stands still) or "part" (moves).
        X_base_piece: Pose, shape (4, 4).
        half_size: Half edge lengths of a box [m], shape (3,); None for a hull.
        vertices: Corners in the piece frame [m], shape (n, 3).
        seen: Whether a camera saw at least one of its faces (else it is a guess).
    """

    name: str
    body: Literal["base", "part"]
    X_base_piece: Array
    half_size: Array | None
    vertices: Array
    seen: bool = True

    @property
    def volume_m3(self) -> float:
        """Volume [m³]."""
        if self.half_size is not None:
            return float(8 * np.prod(self.half_size))
        return float(ConvexHull(self.vertices).volume)

    def faces(self) -> NDArray[np.int64]:
        """Outward triangles over ``vertices``, shape (m, 3)."""
        hull = ConvexHull(self.vertices)
        faces = hull.simplices.astype(np.int64)
        a, b, c = (self.vertices[faces[:, k]] for k in range(3))
        inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
        faces[inward] = faces[inward][:, ::-1]
        return faces


def box(
    name: str, body: Literal["base", "part"], X: Array, low: Array, high: Array, seen: bool = True
) -> Piece:
    """A box between two corners given in the frame X (4, 4)."""
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    half = np.maximum(0.5 * (high - low), 0.0005)
    X_piece = X.copy()
    X_piece[:3, 3] = X[:3, :3] @ (0.5 * (low + high)) + X[:3, 3]
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * half
    return Piece(name, body, X_piece, half, corners, seen)


def hull(name: str, body: Literal["base", "part"], points_base: Array, seen: bool = True) -> Piece:
    """The convex hull of points (n, 3), frame of the views; the piece frame sits at their middle."""
    middle = 0.5 * (points_base.min(axis=0) + points_base.max(axis=0))
    local = points_base - middle
    X = np.eye(4)
    X[:3, 3] = middle
    return Piece(name, body, X, None, local[ConvexHull(local).vertices], seen)


def outside_m(p: Array, pieces: Sequence[Piece], X: Array | None = None) -> Array:
    """How far points lie beyond the faces of the nearest of some pieces, negative inside [m].

    Args:
        p: Points, frame of the views [m], (n, 3).
        pieces: None of them: everything is infinitely far.
        X: Motion of the pieces from where they are, (4, 4); None for none.

    Returns:
        The largest distance to a face's plane, of the piece where that is least, (n,): beyond an edge or a corner less
        than the true distance.
    """
    best = np.full(len(p), np.inf)
    for piece in pieces:
        X_piece = piece.X_base_piece if X is None else X @ piece.X_base_piece
        local = (p - X_piece[:3, 3]) @ X_piece[:3, :3]
        equations = ConvexHull(piece.vertices).equations
        best = np.minimum(best, (local @ equations[:, :3].T + equations[:, 3]).max(axis=1))
    return best
