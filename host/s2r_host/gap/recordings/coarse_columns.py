"""Columns that hold a number in every second row or in fewer: which rows are then compared.

A line between two numbers of a column cuts the peaks off what happened there, and beside channels that show all of it
that is a lag, a clock that runs late or a mass. So the rows that hold the coarsest channel of the motion are the
recording, a slow log like any other; the other channels are read there, from all of their own numbers.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline

from s2r_host.gap.recordings.holes import MOVING

COARSE = 1.5  # rows from number to number, in the middle, that make a column coarse
AS_COARSE = 0.9  # of the longest step: of two streams of one rate positions bear interpolation least
SMOOTH = ("q", "dq")  # what moves has no corners


def coarsest(steps_s: dict[str, float]) -> str | None:
    """The column whose rows are to be compared; None where there is none.

    Args:
        steps_s: Median step between the numbers of each coarse channel of the motion [s], by column.
    """
    longest_s = max(steps_s.values(), default=0.0)
    alike = [column for column, step_s in steps_s.items() if step_s >= AS_COARSE * longest_s]
    return min(alike, key=lambda column: MOVING.index(column.split(".", 1)[0]), default=None)


def is_coarse(present: np.ndarray) -> bool:
    """Does a column hold a number in every second row or in fewer? ``present``: which hold one, shape (rows,)."""
    rows = np.flatnonzero(present)
    return len(rows) > 1 and float(np.median(np.diff(rows))) > COARSE


def between(column: str, t_from: np.ndarray, x: np.ndarray, t: np.ndarray) -> np.ndarray:
    """A coarse column at other times, shape (time,); beyond its own ends it stays as it is there.

    An effort or a command may step, and a spline would swing over (Akima, J. ACM 17(4), 1970).
    """
    smooth = column.split(".", 1)[0] in SMOOTH
    curve = CubicSpline(t_from, x) if smooth else Akima1DInterpolator(t_from, x, method="makima")
    return np.asarray(curve(np.clip(t, t_from[0], t_from[-1])))
