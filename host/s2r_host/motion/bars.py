"""Finding bars on a hub: knobs with two spokes, as long as a short lever and as straight, level, on a hub amidst.

Depth alone does not tell them from levers that turn about an end, whose hub is under that end.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.motion.knobs import Knob, rim_of, spoke_to
from s2r_host.motion.levers import LeverCandidate

LENGTH_M = (0.05, 0.105)  # as a camera sees it, from tip to tip
LEVEL = 0.08  # sine of its rise; levers mostly rise to their tips


def as_bar(lever: LeverCandidate) -> Knob | None:
    """The same piece as a bar on a hub; None for what leans on the body, rises, or is too long or too short."""
    length_m = float(np.linalg.norm(lever.p_tip - lever.p_root))
    if not lever.rooted or abs(lever.direction[2]) > LEVEL or not LENGTH_M[0] < length_m < LENGTH_M[1]:
        return None
    rim = rim_of(lever.p)
    middle = 0.5 * (lever.p_root + lever.p_tip)[:2]
    angle = float(np.arctan2(lever.direction[1], lever.direction[0]))
    height_m = float(np.median(rim[:, 2]))
    spokes = [
        spoke_to(rim, middle, at, 0.5 * length_m, height_m, lever.above_deck_m)
        for at in (angle, angle + np.pi)
    ]
    return Knob(lever.p, tuple(spokes))


def find_bars(levers: Sequence[LeverCandidate]) -> list[Knob]:
    """Those of some pieces that may be bars on a hub."""
    return [bar for lever in levers if (bar := as_bar(lever)) is not None]
