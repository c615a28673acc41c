"""How far the truth may be from what a run believes, from the intervals of its own estimate."""

from __future__ import annotations

from dataclasses import replace

from s2r_host.planning.doubt import Doubt
from s2r_host.planning.doubt_files import doubt_from_estimate
from s2r_host.planning.settings import USUAL_ROOM_M
from s2r_host.run.belief import Belief

TOUCHED_SHARE = 0.25
"""Of the doubt about its place that is left of a side of the part once it has been touched."""


UNSEEN_ROOM_M = 0.010
"""More room for the fingertip to come down beside a hinge's part, on a side that no push has touched yet: the camera
sees a lever from one side, how thick it is is a guess, and a hand-eye error of millimetres comes on top."""

LEAST_ROOMY_SHARE = 0.5  # of the usual doubt, below which a try makes do with the usual room


def doubt_about(belief: Belief, *, growing: bool) -> Doubt:
    """Intervals for a motion that lets the joint grow, or fall.

    A resistance that was felt is known as well as any, and where physics was learnt as well as that explains what was
    felt. A hinge holds its part against gravity wherever it was found,
    so it cannot have less friction than believed.
    """
    usual = Doubt()
    doubt = doubt_from_estimate(belief.estimate.intervals90, belief.model.physics, usual)
    if belief.felt is not None:
        braking = belief.braking or usual.joint_friction
        doubt = replace(doubt, damping=usual.damping, joint_friction=braking)
    if not belief.template.slides:
        low, high = doubt.joint_friction
        doubt = replace(doubt, joint_friction=(max(low, 1.0), high))
        if belief.touched(growing):
            doubt = replace(doubt, shift_sigma_m=TOUCHED_SHARE * doubt.shift_sigma_m)
    return doubt


def deep_about(belief: Belief, share: float) -> bool:
    """Whether a plan should leave out what only grazes the part: where its edges are is known by sight alone."""
    return not belief.template.slides and share >= LEAST_ROOMY_SHARE


def room_about(belief: Belief, *, growing: bool, share: float) -> float:
    """Way to the touch that a plan should leave for a motion that lets the joint grow, or fall [m]."""
    known = belief.template.slides or belief.touched(growing)
    return USUAL_ROOM_M if known or share < LEAST_ROOMY_SHARE else USUAL_ROOM_M + share * UNSEEN_ROOM_M
