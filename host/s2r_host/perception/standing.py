"""Whether a hinge stands on something: somewhere along its axis, where its part is, there is what it is fixed to.

An axis beside a lever explains a short motion of its far end nearly as well as the true one. Often a camera saw through
all of it, in one view or the other: nothing is there for a hinge to be in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.view import Seen

Array = NDArray[np.floating]

# Of the part, along an upright axis, where it is looked at; a level one has no lower end, and both count alike.
BELOW_M, ABOVE_M = 0.05, 0.02
STEP_M = 0.004
EMPTY_M = 0.004  # before a seen surface, from which on space counts as empty


def solid_m(motion: JointMotion, part: Array, scene: Scene, up: Array | None) -> float:
    """Length of the longest stretch of a hinge's axis, beside its part, that no camera saw to be empty [m].

    Args:
        motion: A turn, in the pose of the first view.
        part: Points of the part there [m], (n, 3).
        scene: Both views.
        up: Unit vector against gravity, (3,), None if unknown.
    """
    rise = 0.0 if up is None else float(motion.direction @ up)
    axis = motion.direction if rise >= 0.0 else -motion.direction
    middle, more = 0.5 * (BELOW_M + ABOVE_M), 0.5 * (BELOW_M - ABOVE_M) * abs(rise)
    along = (part - motion.origin) @ axis
    t = np.arange(along.min() - middle - more, along.max() + middle - more, STEP_M)
    p = motion.origin + t[:, None] * axis
    empty = np.zeros(len(p), dtype=bool)
    for view in (scene.before, scene.after):
        empty |= view.look(p, 0.0, EMPTY_M).seen == Seen.FREE
    ends = np.flatnonzero(np.r_[True, empty, True])
    return STEP_M * float(np.diff(ends).max() - 1)
