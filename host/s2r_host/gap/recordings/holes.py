"""Long holes in a recording: the stretches between them count as recordings of their own.

Across a tenth of a second nothing is known of the motion, and a filter that runs over it makes physics of it. A hole is
a jump of the time stamps, or a run of empty cells in a channel that says how the joints moved or were driven.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.recordings.recording import Recording

LONGEST_S = 0.12  # across more than that nothing is known
SLOW_STEPS = 5.0  # usual steps between two rows that make a hole of a slow log
LEAST_STRETCH_ROWS = 50
MOST_LOST = 0.5  # of the time: a recording of holes, bridged, would be all invented
MOVING = (
    "q",
    "dq",
    "tau",
    "q_cmd",
    "dq_cmd",
    "tau_ff",
    "wrench",
)  # others (a temperature) may be logged rarely


def longest_bridged(t: np.ndarray) -> float:
    """Longest step between rows across which a channel is still interpolated [s]."""
    return max(LONGEST_S, SLOW_STEPS * float(np.median(np.diff(t))))


def unknown_rows(t: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Rows inside runs of empty cells that are too long to interpolate, shape (rows,).

    Args:
        t: Time of all rows [s], shape (rows,).
        present: Which rows hold a number, shape (rows,); at least two.
    """
    known = np.flatnonzero(present)
    unknown = (t < t[known[0]]) | (t > t[known[-1]])
    wide = (np.diff(known) > 1) & (np.diff(t[known]) > longest_bridged(t[known]))
    for k in np.flatnonzero(wide):
        unknown[known[k] + 1 : known[k + 1]] = True
    return unknown


def stretches(rec: Recording) -> tuple[list[Recording], list[str]]:
    """The stretches of a recording between its long holes, and what that costs; without holes the recording itself.

    Stretches of fewer than 50 rows are left out, unless there is nothing else.

    Raises:
        GapRecordingError: There is nothing else, and most of the time is holes.
    """
    edges = np.flatnonzero(np.diff(rec.t) > longest_bridged(rec.t)) + 1
    if not edges.size:
        return [rec], []
    pieces = [x for x in np.split(np.arange(len(rec.t)), edges) if len(x) >= LEAST_STRETCH_ROWS]
    lost = sum(float(rec.t[k] - rec.t[k - 1]) for k in edges)
    if not pieces:
        if lost > MOST_LOST * float(rec.t[-1]):
            raise GapRecordingError(
                f"{rec.name}: holes take {lost:.3g} s of its {rec.t[-1]:.3g} s and leave no stretch of "
                f"{LEAST_STRETCH_ROWS} rows; did a clock jump?"
            )
        return [rec], []
    note = (
        f"{rec.name}: {len(edges)} hole(s), {lost:.3g} s in all, are too long to bridge; the {len(pieces)} stretches "
        "between them count as recordings of their own"
    )
    return [_cut(rec, rows) for rows in pieces], [note]


def _cut(rec: Recording, rows: np.ndarray) -> Recording:
    start = float(rec.t[rows[0]])
    return replace(
        rec,
        name=f"{rec.name} from {rec.start_s + start:.6g} s",
        t=rec.t[rows] - start,
        channels={k: {j: x[rows] for j, x in table.items()} for k, table in rec.channels.items()},
        start_s=rec.start_s + start,
    )
