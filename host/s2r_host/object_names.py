"""Names in every object file that is built here: whoever writes one and whoever looks something up in it agree."""

from __future__ import annotations

BASE_BODY, PART_BODY, JOINT = "object_base", "object_part", "object_joint"
PART_PREFIX = "part_"  # of the part's geoms
RIM_PREFIX = "rim_"  # of geoms that nothing touches, within which a part's real edges lie
