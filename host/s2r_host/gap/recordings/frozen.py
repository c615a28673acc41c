"""A position that stands still and catches up while the recorded speed goes on: a sensor that drops out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from s2r_host.gap.recordings.recording import Recording, resolution

LEAST_ROWS, LEAST_STEPS = 1, 6.0  # rows a stop lasts, and encoder steps the speed goes on by
MOST = 0.3  # of the time; a slow sensor always steps
# Of a slow log: how far a row lies beside its neighbours, in what rows usually do. Honest ones reach 63 at ten rows per
# second, where friction turns a stiff loop between two rows; a sensor that stops for 60 ms at twenty makes 380 to 610.
APART = 120.0
LOST = 1.4  # mean step, in usual ones, from which rows are missing: a cubic over a hole says little
TWICE = 2


def frozen(rec: Recording, name: str) -> list[list[float]]:
    """Intervals in which the position repeats itself although the speed says that it cannot, and then catches up.

    Args:
        rec: A fast recording with position and speed of the joint.
        name: The joint.

    Returns:
        Start and end of each stop [s]; empty when there are fewer than two.
    """
    q, dq, t = rec.get("q", name), rec.get("dq", name), rec.t
    assert q is not None
    assert dq is not None
    step = resolution(q)
    found: list[list[float]] = []
    start = 0
    for i in range(1, len(q) + 1):
        if i < len(q) and q[i] == q[start]:
            continue
        way = abs(float(np.sum(0.5 * (dq[start + 1 : i] + dq[start : i - 1]) * np.diff(t[start:i]))))
        jump = abs(float(q[i] - q[start])) if i < len(q) else 0.0
        if i - start > LEAST_ROWS and way > LEAST_STEPS * step and jump > 0.5 * way:
            found.append([float(t[start]) + rec.start_s, float(t[i - 1]) + rec.start_s])
        start = i
    still = sum(b - a for a, b in found)
    return found if len(found) >= TWICE and still < MOST * float(t[-1]) else []


@dataclass(frozen=True)
class LateRows:
    """Rows of a slow log at which the position had stopped: times [s], how far it was off (rms), what is usual."""

    intervals: list[list[float]]
    size: float
    noise: float


def late_rows(rec: Recording, name: str) -> LateRows | None:
    """Single rows whose position stayed behind what position and speed of the rows beside them say.

    The cubic of Hermite through both neighbours says where the joint was at a row; where the loop moves it between
    the rows that errs, at one row as at the next. A sensor that dropped out is off at one row only, and late.

    Args:
        rec: A recording as read.
        name: The joint.

    Returns:
        None without a speed or when there are fewer than two such rows.
    """
    q, dq, t = rec.get("q", name), rec.get("dq", name), rec.t
    if q is None or dq is None or len(t) < 50:
        return None
    before, here, after = slice(0, -2), slice(1, -1), slice(2, None)
    span = t[after] - t[before]
    x = (t[here] - t[before]) / span
    guess = (2 * x**3 - 3 * x**2 + 1) * q[before] + (3 * x**2 - 2 * x**3) * q[after]
    guess = guess + span * ((x**3 - 2 * x**2 + x) * dq[before] + (x**3 - x**2) * dq[after])
    off = q[here] - guess
    alone = off[1:-1] - 0.5 * (off[:-2] + off[2:])
    noise = 1.4826 * float(np.median(np.abs(alone)))
    apart = np.abs(alone)
    top = apart >= maximum_filter1d(apart, 5)  # what is off at one row shows at its neighbours too
    whole = t[4:] - t[:-4] < 4.0 * LOST * float(np.median(np.diff(t)))
    late = whole & top & (apart > APART * max(noise, 0.3 * resolution(q))) & (alone * dq[2:-2] < 0.0)
    if np.count_nonzero(late) < TWICE:
        return None
    rows = np.flatnonzero(late) + 2
    times = [[float(t[i]) + rec.start_s, float(t[i + 1]) + rec.start_s] for i in rows]
    return LateRows(times, float(np.sqrt(np.mean(alone[late] ** 2))), noise)
