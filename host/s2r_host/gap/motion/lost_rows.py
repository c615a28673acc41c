"""Rows that a fast log lost: motion and effort across the holes.

Plain interpolation across a few lost rows cuts off accelerations; at speed that costs many noise floors and looks like
a force that comes and goes. The motion across a hole is read from a smoothing spline through position and speed on both
sides, the effort is what the model needs along it plus what was left over beside the hole: such rows speak neither for
the model nor against it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.motion_spline import STEP_NOISE, motion, smoothing_spline
from s2r_host.gap.motion.slow_log import SLOW_S
from s2r_host.gap.recordings.holes import LONGEST_S
from s2r_host.gap.recordings.recording import Recording, resolution

HOLE_STEPS = 1.9  # usual steps between two rows that make a hole; stamps that jitter stay below
BESIDE = 3  # rows on each side whose leftover is carried across


def bridged(model: RigidModel, rec: Recording) -> tuple[Recording, dict[str, np.ndarray]]:
    """The recording with its holes filled, and how far the effort there may be off.

    Args:
        model: The nominal model.
        rec: A recording as read; one without holes, without speeds or slower than 90 rows per second is returned as is.

    Returns:
        Recording with more rows, and per joint the doubt at the rows of ``rec``, shape (time,) [N·m or N].
    """
    dt, nothing = rec.dt, (rec, {})
    steps = np.diff(rec.t)
    holes = np.flatnonzero((steps > HOLE_STEPS * dt) & (steps < LONGEST_S))
    if not holes.size or dt > SLOW_S or rec.rows is not None:
        return nothing
    if any(rec.get("q", j) is None or rec.get("dq", j) is None for j in model.joints):
        return nothing
    inside = [rec.t[k] + steps[k] * np.arange(1, n) / n for k in holes if (n := round(steps[k] / dt)) > 1]
    t = np.sort(np.concatenate([rec.t, *inside]))
    channels = {
        kind: {name: np.interp(t, rec.t, x) for name, x in table.items()}
        for kind, table in rec.channels.items()
    }
    spans = [
        (int(k), slice(int(np.searchsorted(t, rec.t[k])) + 1, int(np.searchsorted(t, rec.t[k + 1]))))
        for k in holes
    ]
    q, v, a = (np.zeros((len(t), len(model.joints))) for _ in range(3))
    for i, j in enumerate(model.joints):
        x, dx = rec.channels["q"][j], rec.channels["dq"][j]
        curve = smoothing_spline(rec.t, x, dx, STEP_NOISE * resolution(x))
        here, across = motion(curve, rec.t), motion(curve, t)
        q[:, i], v[:, i], a[:, i] = across.q, across.v, across.a
        for k, rows in spans:
            channels["q"][j][rows] = across.q[rows] + _carried(rec.t, x - here.q, k, t[rows])[0]
            channels["dq"][j][rows] = across.v[rows] + _carried(rec.t, dx - here.v, k, t[rows])[0]
    load = model.inverse(q, v, a)
    doubt = {}
    for i, j in enumerate(model.joints):
        tau = rec.get("tau", j)
        if tau is None:
            continue
        left = tau - load[np.searchsorted(t, rec.t), i]
        doubt[j] = np.zeros(len(rec.t))
        for k, rows in spans:
            carried, change = _carried(rec.t, left, k, t[rows])
            channels["tau"][j][rows] = load[rows, i] + carried
            doubt[j][k : k + 2] = np.maximum(doubt[j][k : k + 2], change)
    return replace(rec, t=t, channels=channels), doubt


def _carried(rows: np.ndarray, left: np.ndarray, k: int, t: np.ndarray) -> tuple[np.ndarray, float]:
    """What was left over on both sides of the hole after row ``k``, carried across it, and how far the sides differ.

    Args:
        rows: Times of the rows [s]; ``left`` is what is left over there, both of shape (rows,).
        k: Last row before the hole.
        t: Times inside the hole [s], shape (time,).
    """
    before, after = left[max(k - BESIDE + 1, 0) : k + 1].mean(), left[k + 1 : k + 1 + BESIDE].mean()
    return np.interp(t, rows[k : k + 2], [before, after]), abs(float(after - before))
