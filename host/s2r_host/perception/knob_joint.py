"""The joint of a knob that has turned between two views: its axis is its own, how far it turned say its outlines."""

from __future__ import annotations

import numpy as np

from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.intervals import Intervals
from s2r_host.perception.knob_outline import KnobOutline
from s2r_host.perception.segment import Parts
from s2r_host.perception.view import DepthView

UP = np.array([0.0, 0.0, 1.0])
# 90 % intervals, from the knobs of 16 drawn faucets: axis within 2.6 mm, turns within 0.7 degrees of the truth.
TILT_RAD, SHIFT_M, TURN_RAD = np.radians(2.0), 0.003, np.radians(0.8)
EDGE_M = 0.0005  # how exactly an outline in colour is told


def knob_joint(
    before: DepthView, after: DepthView, outline: KnobOutline, turned: KnobOutline
) -> JointEstimate:
    """The joint of a knob.

    Args:
        before, after: Two views.
        outline, turned: The knob as each of them shows it; angles tell the whole turn between.
    """
    turn = turned.angle - outline.angle
    middle = 0.5 * (outline.p_axis + turned.p_axis)
    parts = Parts(outline.covers(before.points), turned.covers(after.points))
    interval = Intervals(TILT_RAD, SHIFT_M, (abs(turn) - TURN_RAD, abs(turn) + TURN_RAD))
    return JointEstimate(
        "revolute", middle, np.copysign(1.0, turn) * UP, abs(turn), "rad", interval, EDGE_M, before, after, parts, (),
        turned.explained, (), UP, outline,
    )  # fmt: skip
