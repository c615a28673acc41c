"""A part that sticks and slips under a slow fingertip: what it takes in the mean.

Where friction falls with the speed a slow part does not go steadily, it sticks and jumps several times a second
(Armstrong-Hélouvry, Dupont, Canudas de Wit 1994). Each jump is a blow to the arm, and no row between two of them is the
friction at any speed. Over whole cycles the part neither gains nor loses momentum, though, so that the mean effort is
the mean friction, at the mean speed of a fingertip that goes steadily.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_closing, uniform_filter1d

from s2r_host.proprioception.samples import EVERY_S

MEAN_S = 0.5  # of the averages: two cycles of drawn levers and more
APART_S = 0.3  # blows that follow one another so soon are of one bout
LEAST_BLOWS = 6  # of a bout: two in every cycle
SLOW_M_S = 0.015  # of the fingertip: faster jumps are those of the way, as notches have them


def stick_slips(contact: np.ndarray, struck: np.ndarray, speed_m_s: np.ndarray) -> list[np.ndarray]:
    """Rows of every bout of sticking and slipping that is longer than two averages.

    Args:
        contact: Where the fingertip touches the part, (n,).
        struck: Where an effort changes as by a blow, (n,).
        speed_m_s: Of the fingertip, (n,).
    """
    rows = round(APART_S / EVERY_S)
    padded = np.pad(contact & struck, rows)  # the closing of scipy takes what is outside for untouched
    bouts = binary_closing(padded, np.ones(rows + 1))[rows:-rows] & contact
    found = []
    for bout in runs(bouts):
        slow = float(np.median(speed_m_s[bout])) < SLOW_M_S
        if slow and len(bout) * EVERY_S > 2.0 * MEAN_S and len(runs(struck[bout])) >= LEAST_BLOWS:
            found.append(bout)
    return found


def averaged(x: np.ndarray) -> np.ndarray:
    """Running means of rows (n,) over ``MEAN_S``, as far as they are whole."""
    rows = round(MEAN_S / EVERY_S)
    return uniform_filter1d(x, rows)[rows // 2 : len(x) - rows // 2]


def runs(mask: np.ndarray) -> list[np.ndarray]:
    """Rows of every unbroken run of a mask (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [np.arange(start, stop) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
