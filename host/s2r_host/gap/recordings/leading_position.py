"""Positions that run ahead of their speeds by half a step: the mark of a simulator.

A semi-implicit integrator (MuJoCo's Euler and implicit ones) moves the position with the speed at the end of its step:
the slope of the recorded position is ahead of the recorded speed. Without noise that is plain to see, and half a
sample of timing would be read as friction, or as a clock that is late. In recordings of machines it drowns.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from s2r_host.gap.recordings.recording import Recording

PROVEN = 0.95  # share of the difference between both speeds that a constant lead of the position explains
LARGEST = 0.75  # of a step of the record
SMOOTH = 0.9  # of the rows, those of the smallest acceleration
EDGE_ROWS, LEAST_ROWS = 10, 100


def lead_of_position(rec: Recording, joint: str) -> float:
    """How far the slope of the position runs ahead of the recorded speed [s]; 0 where noise would hide it."""
    q, dq = rec.get("q", joint), rec.get("dq", joint)
    if q is None or dq is None or len(q) < LEAST_ROWS:
        return 0.0
    curve = CubicSpline(rec.t, q)
    inner = slice(EDGE_ROWS, -EDGE_ROWS)
    ahead, bend = (curve(rec.t, 1) - dq)[inner], curve(rec.t, 2)[inner]
    smooth = np.abs(bend) < np.quantile(np.abs(bend), SMOOTH)  # a spline rings where a step was commanded
    ahead, bend = ahead[smooth], bend[smooth]
    power = float(bend @ bend)
    if power == 0.0:
        return 0.0
    lead = float(ahead @ bend) / power
    left = ahead - lead * bend
    proven = float(left @ left) < (1.0 - PROVEN) * float(ahead @ ahead)
    return lead if proven and 0.0 < lead < LARGEST * rec.dt else 0.0
