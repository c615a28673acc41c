"""Where and how to push what may be a lever: across its line near its tip, a small angle either way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from s2r_host.motion.fingertip import CLOSED_GRIPPER, Fingertip
from s2r_host.motion.lever_axes import LeverAxis
from s2r_host.motion.levers import LeverCandidate
from s2r_host.motion.push_proposals import PushProposal

DOWN = np.array([0.0, 0.0, -1.0])
NEAR_AXIS = (0.3, 0.2)  # places along a lever whose outer part is out of reach
SHORTEST = 0.3  # of a finger's axis before it is made a unit vector
LEAST_ACROSS = 0.2  # sine between a finger's axis and what its wide side is turned to
SIDEWAYS = 0.7  # cosine between finger and push, below which it pushes with its side


@dataclass(frozen=True)
class LeverPushSettings:
    """Geometry of the first push on a lever [m, rad].

    Attributes:
        turn_rad: How far the lever is to be turned.
        give_m: Way of the fingertip that does not turn it: a camera sees a lever wider than it is, arm and lever yield.
        depth_m: Least and most the fingertip goes for that.
        standoff_m: Free way before the touch.
        places: Along the lever, 0 at its root, 1 at its tip. A finger that goes straight slides outwards while the
            lever turns, by a tenth of its radius over 25°: begun too near to the tip, it slips off.
        below_m: How far the fingertip reaches past the lever's line when it pushes with its side.
        leans: Share of "down" in the finger's axis; the rest points along the push, from outside to the body, or
            outwards: the only way to reach what leads away from the arm.
        highest: Sine by which the finger may point upwards.
        near_axis: Push at :data:`NEAR_AXIS` and nowhere else: an experiment, for there a lever turns furthest for an
            error of a millimetre.
        tip: Of the finger that pushes.
    """

    turn_rad: float = 0.43
    give_m: float = 0.010
    depth_m: tuple[float, float] = (0.02, 0.065)
    standoff_m: float = 0.035
    places: tuple[float, ...] = (0.8, 0.65, 0.5)
    below_m: float = 0.012
    leans: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)
    highest: float = -0.1
    near_axis: bool = False
    tip: Fingertip = CLOSED_GRIPPER


# After all others: below or beside a spout only so much has room, with the hand level with the lever or below it, too.
SHORT = LeverPushSettings(
    turn_rad=0.22, depth_m=(0.015, 0.035), places=(0.8, 0.6), leans=(1.0, 0.5, 0.25, 0.0, -0.25), highest=0.4
)


def lever_proposals(
    lever: LeverCandidate, axis: LeverAxis, settings: LeverPushSettings | None = None
) -> Iterator[PushProposal]:
    """Ways to push a piece, best first.

    Args:
        lever: What to push.
        axis: What it is believed to turn about, first in that axis' sense.
        settings: Geometry of the pushes; those of :data:`SHORT` follow.
    """
    settings = settings or LeverPushSettings()
    line = axis.way(lever.p_tip)
    for one in (settings, replace(SHORT, tip=settings.tip)):
        places = NEAR_AXIS if settings.near_axis else one.places
        for place, lean, direction in product(places, one.leans, (line, -line)):
            for level in (direction, -lever.outward, lever.outward):
                z = lean * DOWN + (1.0 - abs(lean)) * level
                length = float(np.linalg.norm(z))
                if length > SHORTEST and z[2] < one.highest * length:
                    yield from _pushes(lever, axis, place, z / length, direction, one)
                if lean == 1.0:
                    break


def _pushes(
    lever: LeverCandidate,
    axis: LeverAxis,
    place: float,
    z: np.ndarray,
    direction: np.ndarray,
    settings: LeverPushSettings,
) -> Iterator[PushProposal]:
    """The finger points along ``z``, both ways round and across."""
    p_line = lever.p_root + place * (lever.p_tip - lever.p_root)
    depth = float(np.clip(settings.turn_rad * axis.radius(p_line) + settings.give_m, *settings.depth_m))
    point = p_line - 0.5 * lever.width_m * direction
    if abs(z @ direction) < SIDEWAYS:
        point = point + settings.below_m * z
    for R in _rolls(z, direction, lever.outward):
        p_contact = point - settings.tip.ahead_m(R, direction) * direction
        X = np.eye(4)
        X[:3, :3] = R
        X[:3, 3] = p_contact - settings.standoff_m * direction
        yield PushProposal(X, p_contact, p_contact + depth * direction, direction)


def _rolls(z: np.ndarray, direction: np.ndarray, aside: np.ndarray) -> Iterator[np.ndarray]:
    """The finger's wide side across the push, either way round, then along it; ``aside`` for pushes straight down."""
    for x in (np.cross(direction, DOWN), aside, DOWN):
        x = x - (x @ z) * z
        length = float(np.linalg.norm(x))
        if length > LEAST_ACROSS:
            break
    x /= length
    y = np.cross(z, x)
    for a, b in ((x, y), (-x, -y), (y, -x), (-y, x)):
        yield np.column_stack([a, b, z])
