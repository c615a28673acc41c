"""Times at which something was seen, as intervals."""

from __future__ import annotations

from collections.abc import Iterable

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
