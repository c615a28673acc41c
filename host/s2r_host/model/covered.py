"""What stands where the part was in both views is not of the base: its own points, taken for a thing that stayed.

A lever that turned by less than its own width covers much of the place it had. There its surface is seen at the same
depth before and after, so that it counts as static, and a block of it would stand in the lever's own way. Between the
two places it is another matter: a thing seen there twice stands so near to the lever's way that no look keeps them
apart, a spout below the end of its lever, and the arm must not run into it.
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
Mask = NDArray[np.bool_]

FAT_M = 0.005  # by which a matching window fattens what it sees


def without_covered(seen: ObservedObject, pieces: Sequence[Piece], motion: JointMotion) -> ObservedObject:
    """The object without static points that lie in some pieces of the part in both views.

    Args:
        seen: The object, in the pose of the first view.
        pieces: Of the part, in the same pose. Pieces that only guess the part's extent would eat into the base.
        motion: From the first view to the second.
    """
    before, after = (_within(seen.rest, pieces, X) for X in (np.eye(4), motion.transform()))
    stands = ~(before & after)
    return replace(seen, rest=seen.rest[stands], rest_normals=seen.rest_normals[stands])


def _within(p: Array, pieces: Sequence[Piece], X: Array) -> Mask:
    """Which of points (n, 3) lie in any piece, or nearly so, once X (4, 4) has moved the part."""
    found = np.zeros(len(p), dtype=bool)
    for piece in pieces:
        X_piece = X @ piece.X_base_piece
        equations = ConvexHull(piece.vertices).equations
        local = (p - X_piece[:3, 3]) @ X_piece[:3, :3]
        found |= (local @ equations[:, :3].T + equations[:, 3] < FAT_M).all(axis=1)
    return found
