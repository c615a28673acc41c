"""What stands where the part went is not of the base: points of the part that were taken for a thing that stayed.

A lever that turned by less than its own width covers much of the place it had. There its surface is seen at the same
depth before and after, so that it counts as static, and a block of it would stand in the lever's own way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from s2r_host.model.pieces import Piece
from s2r_host.model.points import ObservedObject
from s2r_host.perception.motion import JointMotion

Array = NDArray[np.floating]

FAT_M = 0.005  # by which a matching window fattens what it sees
STEP_M = 0.004  # between two poses, at the corner that goes furthest


def without_swept(seen: ObservedObject, pieces: Sequence[Piece], motion: JointMotion) -> ObservedObject:
    """The object without static points where some pieces of the part were between the two views.

    Args:
        seen: The object, in the pose of the first view.
        pieces: Of the part, in the same pose. Pieces that only guess the part's extent would eat into the base.
        motion: From the first view to the second.
    """
    gone = np.zeros(len(seen.rest), dtype=bool)
    for piece in pieces:
        corners = piece.vertices @ piece.X_base_piece[:3, :3].T + piece.X_base_piece[:3, 3]
        X_end = motion.transform()
        way_m = np.linalg.norm(corners @ X_end[:3, :3].T + X_end[:3, 3] - corners, axis=1).max()
        for share in np.linspace(0.0, 1.0, 2 + int(way_m / STEP_M)):
            X = replace(motion, delta=share * motion.delta).transform() @ piece.X_base_piece
            gone |= _inside(seen.rest, piece, X)
    return replace(seen, rest=seen.rest[~gone], rest_normals=seen.rest_normals[~gone])


def _inside(p: Array, piece: Piece, X: Array) -> NDArray[np.bool_]:
    """Which of points (n, 3) lie in a piece at a pose X (4, 4), or nearly so."""
    equations = ConvexHull(piece.vertices).equations
    local = (p - X[:3, 3]) @ X[:3, :3]
    return np.asarray((local @ equations[:, :3].T + equations[:, 3] < FAT_M).all(axis=1))
