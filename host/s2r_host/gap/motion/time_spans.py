"""Where something was seen, as intervals of time or of rows."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

BREAK_S = 0.15  # apart, two times belong to two intervals


def time_spans(times: Iterable[float], break_s: float = BREAK_S) -> list[list[float]]:
    """Rising times [s] as intervals [first, last]; those less than ``break_s`` after the last one continue it."""
    found: list[list[float]] = []
    for time in times:
        if found and time - found[-1][1] < break_s:
            found[-1][1] = float(time)
        else:
            found.append([float(time), float(time)])
    return found


def runs(mask: np.ndarray) -> np.ndarray:
    """Where a mask holds without a break: first row and the one after the last, shape (runs, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]]))).reshape(-1, 2)
