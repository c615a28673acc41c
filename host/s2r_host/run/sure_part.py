"""The part as far as a fingertip may count on it: without the last millimetres of its free edges.

Where an edge ends is known to some millimetres: matching windows fatten it, calibration shifts it, outlines are cut
into cells. A plan that hooks the outermost millimetres slips over the edge, and then presses on it from above until
the executor takes that for a collision. Slides are left alone: theirs is what is hooked behind, not along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from s2r_host.model.pieces import Piece, hull
from s2r_host.perception.motion import JointMotion

EDGE_M = 0.008
EDGE_SHARE = 0.08  # of a part's length: a short lever has no eight millimetres to give
WIDE_M = 0.1  # along the hinge, from which on a part may be slipped off sideways
ONE_SIDED = 0.3  # of its length, how far from the axis a part's middle is that has one free end
LEAST_LEFT_M = 0.004
AT_EDGE_M = 0.0015  # as near to where the part was cut back as a touch is known

HalfSpace = tuple[np.ndarray, float]
"""n (3,) and d [m]: the points p with n · p ≤ d, base frame at joint value 0."""


def sure_within(pieces: Sequence[Piece], hinge: JointMotion) -> tuple[HalfSpace, ...]:
    """Where a hinge's part is sure: short of its free end and, where it is wide, of its sides.

    Args:
        pieces: Of the object, in the pose of the first view.
        hinge: Its joint.
    """
    corners = np.concatenate([_corners(piece) for piece in pieces if piece.body == "part"]) - hinge.origin
    axis = hinge.direction
    outward = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    outward = outward - (outward @ axis) * axis
    middle_m = float(np.linalg.norm(outward))
    limits: list[HalfSpace] = []
    if middle_m > 0.0:
        outward = outward / middle_m
        length_m = float((corners @ outward).max())
        if middle_m > ONE_SIDED * length_m:
            limits.append((outward, length_m - min(EDGE_M, EDGE_SHARE * length_m)))
    along = corners @ axis
    if np.ptp(along) > WIDE_M:
        limits += [(axis, float(along.max()) - EDGE_M), (-axis, float(-along.min()) - EDGE_M)]
    return tuple((normal, limit_m + float(normal @ hinge.origin)) for normal, limit_m in limits)


def sure_pieces(pieces: Sequence[Piece], within: Sequence[HalfSpace]) -> list[Piece]:
    """All pieces, those of a hinge's part cut back to where it is sure."""
    part = [piece for piece in pieces if piece.body == "part"]
    for normal, limit_m in within:
        left = [_cut(piece, normal, limit_m) for piece in part]
        part = [piece for piece in left if piece is not None]
    return [*part, *(piece for piece in pieces if piece.body != "part")]


def rims(pieces: Sequence[Piece], sure: Sequence[Piece]) -> list[Piece]:
    """Pieces of the part that were cut back, whole: as far as it may reach, which is as far as it was seen to.

    Args:
        pieces: Of the object.
        sure: Of :func:`sure_pieces`.
    """
    kept = {id(piece) for piece in sure}
    return [piece for piece in pieces if piece.body == "part" and id(piece) not in kept]


def at_an_edge(p: np.ndarray, within: Sequence[HalfSpace]) -> bool:
    """Whether a point (3,) of the part lies where it was cut back: its real edge is somewhere beyond.

    A fingertip that comes slantwise over a free edge pushes the edge with its side. There a part that is 8 mm longer
    goes half a degree further than one that was cut back.
    """
    return any(float(normal @ p) > limit_m - AT_EDGE_M for normal, limit_m in within)


def _corners(piece: Piece) -> np.ndarray:
    return piece.vertices @ piece.X_base_piece[:3, :3].T + piece.X_base_piece[:3, 3]


def _cut(piece: Piece, direction: np.ndarray, limit_m: float) -> Piece | None:
    """What of a piece lies below a limit along a unit direction; None if that is next to nothing.

    Corners beyond the limit are pulled back to it, which for plates and bars along the direction is the same.
    """
    corners = _corners(piece)
    height = corners @ direction
    if height.max() <= limit_m:
        return piece
    if height.min() > limit_m - LEAST_LEFT_M:
        return None
    if piece.half_size is None:
        pulled = corners - np.maximum(height - limit_m, 0.0)[:, None] * direction
        return hull(piece.name, piece.body, pulled, piece.seen)
    R = piece.X_base_piece[:3, :3]
    k = int(np.argmax(np.abs(R.T @ direction)))
    by_m = min(float(height.max()) - limit_m, 2.0 * float(piece.half_size[k]) - LEAST_LEFT_M)
    half, X = piece.half_size.copy(), piece.X_base_piece.copy()
    half[k] -= 0.5 * by_m
    X[:3, 3] -= 0.5 * by_m * np.sign(R[:, k] @ direction) * R[:, k]
    return replace(piece, X_base_piece=X, half_size=half, vertices=np.sign(piece.vertices) * half)
