"""What stands where the part was in both views is not of the base: its own points, taken for a thing that stayed.

A lever that turned by less than its own width covers much of the place it had. There its surface is seen at the same
depth before and after, so that it counts as static, and a block of it would stand in the lever's own way. Between the
two places it is another matter: a thing seen there twice stands so near to the lever's way that no look keeps them
apart, a spout below the end of its lever, and the arm must not run into it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from s2r_host.model.pieces import Piece, outside_m
from s2r_host.model.points import ObservedObject
from s2r_host.perception.motion import JointMotion

FAT_M = 0.005  # by which a matching window fattens what it sees


def without_covered(seen: ObservedObject, pieces: Sequence[Piece], motion: JointMotion) -> ObservedObject:
    """The object without static points that lie in some pieces of the part in both views.

    Args:
        seen: The object, in the pose of the first view.
        pieces: Of the part, in the same pose. Pieces that only guess the part's extent would eat into the base.
        motion: From the first view to the second.
    """
    before = outside_m(seen.rest, pieces) < FAT_M
    after = outside_m(seen.rest, pieces, motion.transform()) < FAT_M
    stands = ~(before & after)
    return replace(seen, rest=seen.rest[stands], rest_normals=seen.rest_normals[stands])
