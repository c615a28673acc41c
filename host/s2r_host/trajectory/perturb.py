"""Objects a little different from the believed one, to find out whether a motion holds only by luck."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_host.planning.belief import Belief
from s2r_host.planning.doubt import Doubt

# The planner's friction is 0.1. Little friction loses a part, much friction jams a fingertip on an edge: away from the
# robot both are tried, whatever is believed.
_SMOOTH, _ROUGH = 1.0, 6.0
_FAR, _FARTHER = 1.5, 2.0  # standard deviations: 3 and 4 mm of the usual 2 mm


def perturbed(doubt: Doubt, axis: np.ndarray | None = None) -> tuple[Belief, ...]:
    """Objects at the ends of what is believable, which a motion must move as well.

    Seven are displaced, with little or much resistance and friction. Where the joint itself is in doubt four more have
    its axis tilted and its pivot moved, to four sides, and the part a little further or less far.

    Args:
        doubt: The intervals.
        axis: Direction of the joint in the world frame, (3,); needed where the joint is in doubt.
    """
    far, farther = _FAR * doubt.shift_sigma_m, _FARTHER * doubt.shift_sigma_m
    (easy, hard), (smooth, rough) = (0, 1), (_SMOOTH, _ROUGH)
    found = [
        _displaced(doubt, (far, 0.0, 0.0), easy, smooth),
        _displaced(doubt, (far, 0.0, 0.0), hard, rough),
        _displaced(doubt, (-far, 0.0, 0.0), hard, rough),
        _displaced(doubt, (0.0, 0.0, far), easy, rough),
        _displaced(doubt, (0.0, 0.0, -far), hard, smooth),
        _displaced(doubt, (0.0, farther, 0.0), None, rough),
        _displaced(doubt, (0.0, -farther, 0.0), None, rough),
    ]
    if doubt.about_joint and axis is not None:
        first, second = _across(axis)
        for side, along in ((first, 1.0), (-first, -1.0), (second, -1.0), (-second, 1.0)):
            tilt, pivot = doubt.axis_angle_rad * side, doubt.axis_offset_m * side
            found.append(Belief(tilt_rad=_vector(tilt), pivot_m=_vector(pivot), along=along * doubt.along))
    return tuple(found)


def _displaced(doubt: Doubt, shift_m: tuple[float, float, float], end: int | None, friction: float) -> Belief:
    """At one end of the intervals of the joint's resistance; None: as in the file."""
    belief = Belief(shift_m, friction)
    if end is None:
        return belief
    return replace(belief, damping=doubt.damping[end], joint_friction=doubt.joint_friction[end])


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that are upright to a unit vector and to each other; one as level as can be."""
    level = np.cross(axis, [0.0, 0.0, 1.0])
    if np.linalg.norm(level) < 0.1:
        level = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    level /= np.linalg.norm(level)
    return level, np.cross(level, axis)


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def farthest_m(doubt: Doubt) -> float:
    """How far the farthest of these objects is displaced [m]."""
    return _FARTHER * doubt.shift_sigma_m


PERTURBATIONS = perturbed(Doubt())
"""For errors of calibration and perception of 1 to 2 mm; friction and damping are typed in, not measured."""
