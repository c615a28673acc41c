"""A handle with equal spokes looks the same after a turn by their spacing: which way and how far it went is then open.

Whether a part is of that sort shows in each view by itself: turned about the axis by the spacing, the part lands on
itself. A lever lands in free space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NoReturn

import numpy as np

from s2r_host.perception.change import Change
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.evidence import Probe, Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.view import Seen

SPOKES = (2, 3, 4, 5, 6)
ON_ITSELF = (
    0.6  # of the turned points; crosses seen by a stereo camera reach 0.77 to 0.93, levers stay below 0.4
)
ALIKE = 0.1  # four spokes also land on themselves as two do: the most spokes within this share win
FEWEST, LEAST_JUDGED = (
    60,
    0.25,
)  # points that can be judged, and their share: half a turn hides a lid in its table
LEAST_MOVED = (
    0.25  # of the landings have to be on surface that moved itself; a lid that is turned lands on its box
)
EXTRA_M = 0.003  # the axis of the answer may be off by some millimetres
LONGER = 3.0  # a turn so many times as long as the answer is not feared


def spokes(motion: JointMotion, scene: Scene, probes: tuple[Probe, Probe]) -> int:
    """Number of equal spokes with which the part lands on itself in both views; 1 if there is none."""
    if motion.joint_type != "revolute":
        return 1
    share = {count: _share_on_itself(motion, count, scene, probes) for count in SPOKES}
    return most_spokes(share)


def most_spokes(share: Mapping[int, float]) -> int:
    """Number of equal spokes, by the share of the part that lands on itself with each number; 1 if there is none."""
    best = max(share.values())
    return max(count for count in share if share[count] >= best - ALIKE) if best >= ON_ITSELF else 1


def other_turn(motion: JointMotion, count: int) -> JointMotion | None:
    """The turn the other way that so many equal spokes make as good an answer; None where none is to be feared."""
    spacing = 2 * np.pi / count
    other = spacing - motion.delta % spacing  # an answer may go on past the next spoke
    if count == 1 or other >= LONGER * motion.delta:
        return None
    return replace(motion, direction=-motion.direction, delta=other)


def refuse_two_turns(motion: JointMotion, other: JointMotion, count: int) -> NoReturn:
    """Refuse an answer that the turn the other way would give about as well.

    Raises:
        AbstainError: Names both turns.
    """
    spacing_deg = 360.0 / count
    raise AbstainError(
        f"the part looks alike after every {spacing_deg:.0f} degrees: a turn by"
        f" {np.degrees(motion.delta):.0f} degrees and one by {np.degrees(other.delta):.0f} the other way explain the"
        f" views alike; push by less than {spacing_deg / (1 + LONGER):.0f} degrees between the views"
    )


def _share_on_itself(motion: JointMotion, count: int, scene: Scene, probes: tuple[Probe, Probe]) -> float:
    """Of a view's moved points, turned by the spacing on or back, those that land on moved surface of that view."""
    X = replace(motion, delta=2 * np.pi / count).transform()
    shares = []
    for T in (X, np.linalg.inv(X)):
        on = moved = judged = 0
        for part, view, label in (
            (probes[0], scene.before, scene.changes.before),
            (probes[1], scene.after, scene.changes.after),
        ):
            found = view.look(part.points @ T[:3, :3].T + T[:3, 3], part.sigma_m, EXTRA_M)
            surface = found.seen == Seen.SURFACE
            there = label[np.maximum(found.index, 0)]
            on += int((surface & (there != Change.STATIC)).sum())
            moved += int((surface & (there == Change.MOVED)).sum())
            judged += int((surface | (found.seen == Seen.FREE)).sum())
        enough = max(FEWEST, LEAST_JUDGED * (len(probes[0].points) + len(probes[1].points)))
        shares.append(on / judged if judged >= enough and moved >= LEAST_MOVED * on else 0.0)
    return min(shares)
