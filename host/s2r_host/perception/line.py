"""The straight line that most points of a thin part lie along."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

HUB_M = 0.03  # about a hinge's axis, where hub and column are
LINE_M = 0.022  # points this near to the line are the bar's
LEAST_SHARE = 0.6  # of the points outside of the hub
FIT_STEPS = 6
LEAST_POINTS = 150


def main_line(p: Array) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """Centre (3,), unit vector (3,) and points (n,) of the line that most of some points (n, 3) lie near.

    None if there is no such line.
    """
    if len(p) < LEAST_POINTS:
        return None
    near = np.ones(len(p), dtype=bool)
    centre, along = p.mean(axis=0), np.zeros(3)
    for _ in range(FIT_STEPS):
        if near.sum() < LEAST_POINTS:
            return None
        centre = np.median(p[near], axis=0)
        along = np.linalg.eigh(np.cov((p[near] - centre).T))[1][:, 2]
        off = (p - centre) - np.outer((p - centre) @ along, along)
        near = np.linalg.norm(off, axis=1) < LINE_M
    return (centre, along, near) if near.mean() > LEAST_SHARE else None
