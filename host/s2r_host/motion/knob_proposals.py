"""Where and how to push a knob whose outline is known: by the side of a spoke, beside the hub.

The spokes of a cross handle stand out by one or two centimetres, less than a fingertip is wide. Pushed half-way along
its line as a lever is, the fingertip meets the hub and jams. As a spoke turns away from a fingertip that goes straight
on, its outer points go furthest, and what still touches is the fingertip's inner edge: the further out that is, the
less force the knob takes. An arm whose wrist bears 14 N m may push with some 40 N only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from s2r_host.motion.fingertip import CLOSED_GRIPPER, Fingertip
from s2r_host.motion.lever_proposals import DOWN
from s2r_host.motion.push_proposals import PushProposal
from s2r_host.perception.knob_outline import KnobOutline


@dataclass(frozen=True)
class KnobPushSettings:
    """Geometry of the first push on a knob [m, rad].

    Attributes:
        turn_rad: How far it is to be turned.
        most_share: Of the spacing of its spokes, which is as far as two looks can tell a turn, half of it.
        give_m: Way of the fingertip that does not turn it.
        standoff_m: Free way before the touch.
        below_m: How far the fingertip reaches below the top, at most the share of the height that ``foot_share`` says.
        foot_share: Of the height of the knob.
        beside_m: Least way between fingertip and hub.
        overlap_m: Of fingertip and spoke at the end of the turn.
        leans: Of the finger from upright, outwards from the knob or along the push.
        tip: Of the finger that pushes.
    """

    turn_rad: float = 0.35
    most_share: float = 0.3
    give_m: float = 0.006
    standoff_m: float = 0.035
    below_m: float = 0.010
    foot_share: float = 0.6
    beside_m: float = 0.002
    overlap_m: float = 0.003
    leans: tuple[float, ...] = (0.0, 0.3, 0.6)
    tip: Fingertip = CLOSED_GRIPPER


def knob_proposals(outline: KnobOutline, settings: KnobPushSettings | None = None) -> Iterator[PushProposal]:
    """Ways to turn a knob, upright fingers first, then leaning ones; for each every spoke, either way."""
    settings = settings or KnobPushSettings()
    for lean, wide in product(settings.leans, (True, False)):
        for angle, sense in product(outline.angles(), (1.0, -1.0)):
            out = np.array([np.cos(angle), np.sin(angle), 0.0])
            direction = sense * np.array([-out[1], out[0], 0.0])
            for level in (out,) if lean == 0.0 else (-out, direction, -direction):
                z = np.cos(lean) * DOWN + np.sin(lean) * level
                yield from _pushes(outline, out, direction, z, wide, settings)


def _pushes(
    outline: KnobOutline,
    out: np.ndarray,
    direction: np.ndarray,
    z: np.ndarray,
    wide: bool,
    settings: KnobPushSettings,
) -> Iterator[PushProposal]:
    """The finger points along ``z``, its wide or its narrow side across the push, either way round."""
    tip = settings.tip
    along, across = (tip.width_m, tip.depth_m) if wide else (tip.depth_m, tip.width_m)
    turn = min(settings.turn_rad, settings.most_share * outline.pitch)
    inner = max(outline.hub_m + settings.beside_m, outline.reach_m * np.cos(turn) - settings.overlap_m)
    depth = turn * inner + settings.give_m
    height = float(outline.p_axis[2]) - outline.foot_m
    below = min(settings.below_m, settings.foot_share * height)
    start = 0.5 * (outline.width_m + across)
    p_contact = outline.p_axis + (inner + 0.5 * along) * out - start * direction + below * DOWN
    x = out - (out @ z) * z
    x /= np.linalg.norm(x)
    for one in (x, -x):
        y = np.cross(z, one)
        R = np.column_stack([one, y, z] if wide else [-y, one, z])
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = R, p_contact - settings.standoff_m * direction
        yield PushProposal(X, p_contact, p_contact + depth * direction, direction)
