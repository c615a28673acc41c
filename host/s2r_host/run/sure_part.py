"""How far out a fingertip may count on a part: not on the last millimetres of its free edges.

Where an edge ends is known to some millimetres: matching windows fatten it, calibration shifts it, outlines are cut
into cells. A plan that hooks the outermost millimetres slips over the edge, and then presses on it from above until
the executor takes that for a collision. Slides are left alone: theirs is what is hooked behind, not along.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.model.pieces import Piece
from s2r_host.perception.motion import JointMotion

EDGE_M = 0.008
EDGE_SHARE = 0.08  # of a part's length: a short lever has no eight millimetres to give
WIDE_M = 0.1  # along the hinge, from which on a part may be slipped off sideways
ONE_SIDED = 0.3  # of its length, how far from the axis a part's middle is that has one free end

HalfSpace = tuple[float, float, float, float]
"""n and d [m]: points p with n · p ≤ d, part's frame (base frame at joint value 0)."""


def sure_within(pieces: Sequence[Piece], hinge: JointMotion) -> tuple[HalfSpace, ...]:
    """Where a fingertip may push a hinge's part: short of its free end and, where it is wide, of its sides.

    Args:
        pieces: Of the object, in the pose of joint value 0.
        hinge: Its joint.
    """
    corners = np.concatenate([_corners(piece) for piece in pieces if piece.body == "part"]) - hinge.origin
    axis = hinge.direction
    outward = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    outward = outward - (outward @ axis) * axis
    middle_m = float(np.linalg.norm(outward))
    limits: list[tuple[np.ndarray, float]] = []
    if middle_m > 0.0:
        outward = outward / middle_m
        length_m = float((corners @ outward).max())
        if middle_m > ONE_SIDED * length_m:
            limits.append((outward, length_m - min(EDGE_M, EDGE_SHARE * length_m)))
    along = corners @ axis
    if np.ptp(along) > WIDE_M:
        limits += [(axis, float(along.max()) - EDGE_M), (-axis, float(-along.min()) - EDGE_M)]
    return tuple((*(float(x) for x in n), d + float(n @ hinge.origin)) for n, d in limits)


def outside(p: np.ndarray, within: Sequence[HalfSpace]) -> bool:
    """Whether a point (3,) of the part's frame lies beyond one of its limits."""
    return any(np.dot(limit[:3], p) > limit[3] for limit in within)


def _corners(piece: Piece) -> np.ndarray:
    return piece.vertices @ piece.X_base_piece[:3, :3].T + piece.X_base_piece[:3, 3]
