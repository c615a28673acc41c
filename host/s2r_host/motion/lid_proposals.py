"""Where and how to push a lid first: near its free edge, a little way shut, or open where that tells more.

A lid that was found open can close by about as much as it is open; how much further it would open is not known, and
pushing against its stop would end in a protection stop. Hence closing first, unless it would turn the face that the
first view saw away from the camera: two views of different faces have no surface in common to fit the joint to.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from s2r_host.motion.fingertip import CLOSED_GRIPPER, Fingertip
from s2r_host.motion.lid import Lid
from s2r_host.motion.push_proposals import PushProposal


@dataclass(frozen=True)
class LidPushSettings:
    """Geometry of the first push on a lid [m, rad].

    Attributes:
        turn_rad: How far the lid is to be turned.
        depth_m: Least and most the fingertip goes for that.
        standoff_m: Free way before the touch.
        hidden_m: A lid is not thicker than this; its hidden face is looked for there.
        overlap_m: How far below the free edge the fingertip reaches when it pushes with its side.
        edge_m: How far below the free edge it touches when it pushes with its end.
        across: Places along the hinge as shares of the width, 0 is the middle.
        leans: Tilt of the finger from "along the push" (0) over "down along the lid" (1) to "reaching over it" (> 1).
        least_angle_rad: Lids less open than this are not pushed further shut.
        safe_open_rad: Up to here every lid is believed to open.
        least_facing: Least cosine between the seen face and the ray to the camera that the second view needs.
        tip: Of the finger that pushes.
    """

    turn_rad: float = 0.4
    depth_m: tuple[float, float] = (0.04, 0.10)
    standoff_m: float = 0.04
    hidden_m: float = 0.010
    overlap_m: tuple[float, ...] = (0.03, 0.022)
    edge_m: tuple[float, ...] = (0.025,)
    across: tuple[float, ...] = (0.0, 0.2, -0.2, 0.38, -0.38)
    leans: tuple[float, ...] = (1.0, 0.5, 0.0, 1.5, 2.2, 0.75, 0.25, 3.0)
    least_angle_rad: float = 0.7
    safe_open_rad: float = 1.75
    least_facing: float = 0.15
    tip: Fingertip = CLOSED_GRIPPER


def lid_proposals(lid: Lid, settings: LidPushSettings | None = None) -> Iterator[PushProposal]:
    """Proposals, best first."""
    settings = settings or LidPushSettings()
    for sign in _directions(lid, settings):
        yield from _pushes(lid, sign, settings)


def _directions(lid: Lid, settings: LidPushSettings) -> list[float]:
    """-1 for closing, 1 for opening, in the order to try."""
    if lid.angle_rad < settings.least_angle_rad:
        return [1.0]
    stays_in_view = lid.facing(-settings.turn_rad) >= settings.least_facing
    may_open = lid.angle_rad + settings.turn_rad <= settings.safe_open_rad
    return [-1.0, 1.0] if stays_in_view or not may_open else [1.0, -1.0]


def _pushes(lid: Lid, sign: float, settings: LidPushSettings) -> Iterator[PushProposal]:
    direction = sign * lid.opening
    # The face that is touched looks against the push; if the camera saw the other one, it lies deeper.
    touched_seen = lid.outside_seen == (sign < 0.0)
    face = lid.p_hinge - (0.0 if touched_seen else settings.hidden_m) * direction
    for lean in settings.leans:
        z = lean * -lid.up + (1.0 - lean) * direction
        z /= np.linalg.norm(z)
        if z[2] > -0.2:  # a finger that points up or level comes from below the table or through it
            continue
        for below in settings.overlap_m if lean > 0.6 else settings.edge_m:
            height = lid.length_m - below
            depth = float(np.clip(settings.turn_rad * height, *settings.depth_m))
            for share in settings.across:
                point = face + share * lid.width_m * lid.along + height * lid.up
                for R in _rolls(z, lid.along):
                    p_contact = point - settings.tip.ahead_m(R, direction) * direction
                    X = np.eye(4)
                    X[:3, :3] = R
                    X[:3, 3] = p_contact - settings.standoff_m * direction
                    yield PushProposal(X, p_contact, p_contact + depth * direction, direction)


def _rolls(z: np.ndarray, along: np.ndarray) -> Iterator[np.ndarray]:
    """The finger's wide side along the hinge, either way round, then across it."""
    x = along - (along @ z) * z
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    for R in ((x, y), (-x, -y), (y, -x), (-y, x)):
        yield np.column_stack([*R, z])
