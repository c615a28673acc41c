"""Names every object uses in MuJoCo, so that physics, camera and truth log need not know the kind."""

from __future__ import annotations

BASE_BODY = "object_base"
PART_BODY = "object_part"
JOINT = "object_joint"
