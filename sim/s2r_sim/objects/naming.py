"""Names every object uses in MuJoCo, so that physics, camera and truth log need not know the kind."""

from __future__ import annotations

BASE_BODY = "object_base"
PART_BODY = "object_part"
JOINT = "object_joint"
FAR_BODY = "object_far"  # of a part that bends: what lies beyond the bend, seen from the joint
BEND_JOINT = "object_bend"


def other_part(place: str) -> tuple[str, str]:
    """Names of body and joint of a part that moves besides the one told of, by its place in the object."""
    return f"{PART_BODY}_{place}", f"{JOINT}_{place}"
