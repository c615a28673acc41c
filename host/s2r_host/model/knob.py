"""A knob with spokes: a round hub and a box per spoke, as its outline in colour has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from s2r_host.model.pieces import Piece, box, hull

if TYPE_CHECKING:
    from s2r_host.perception.knob_outline import KnobOutline

THICK_M = 0.012  # of spokes, which no camera tells; a fingertip meets them near their top
CORNERS = 16  # of the prism that stands for the hub
ON_FOOT_M = 0.006  # above what it stands on, where that is seen no more
# Beside a knob, as far as fingers go, and so little above what it stands on, readings are noise at its rim.
SKIRT_M, SKIRT_FROM_M, SKIRT_TO_M = 0.030, 0.0085, 0.010


def knob_pieces(outline: KnobOutline) -> list[Piece]:
    """Hub and spokes of the moving part, in the pose of the outline."""
    top = float(outline.p_axis[2])
    pieces = [_prism("hub", outline, outline.hub_m / np.cos(np.pi / CORNERS), outline.foot_m, top, 0.5)]
    half = 0.5 * outline.width_m
    for k, turn in enumerate(outline.angles()):
        X = np.eye(4)
        X[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        X[:3, 3] = outline.p_axis
        low = np.array([0.0, -half, -min(THICK_M, top - outline.foot_m)])
        pieces.append(box(f"spoke{k}", "part", X, low, np.array([outline.reach_m, half, 0.0])))
    return pieces


def around_knob(outline: KnobOutline) -> list[Piece]:
    """Everything that the knob may take up, whatever way it is turned, and the noise beside its foot: nothing stands
    there but the knob."""
    top, foot = float(outline.p_axis[2]), outline.foot_m
    reach_m = float(np.hypot(outline.reach_m, 0.5 * outline.width_m))
    return [
        _prism("around", outline, reach_m, foot + ON_FOOT_M, top, 0.0),
        _prism("skirt", outline, reach_m + SKIRT_M, foot + SKIRT_FROM_M, foot + SKIRT_TO_M, 0.0),
    ]


def _prism(
    name: str, outline: KnobOutline, corner_m: float, low_m: float, high_m: float, first: float
) -> Piece:
    """An upright prism about the axis, from one height to another; ``first`` corner, in steps from x."""
    angle = 2.0 * np.pi * (np.arange(CORNERS) + first) / CORNERS
    ring = outline.p_axis[:2] + corner_m * np.column_stack([np.cos(angle), np.sin(angle)])
    ends = [np.column_stack([ring, np.full(CORNERS, z)]) for z in (low_m, high_m)]
    return hull(name, "part", np.concatenate(ends))
