"""By how much a part with equal spokes turns until it looks as before: a look tells its state up to that only."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from s2r_host.perception.motion import line_distance
from s2r_host.perception.symmetry import SPOKES, most_spokes
from s2r_host.run.measure import PartTemplate

OUTER = 0.5  # of the radius within which nine tenths of its points lie: hubs are round
NEAR_M = 0.005
LEAST_POINTS = 60


def spacing_of(template: PartTemplate) -> float | None:
    """Angle between a part's equal spokes [rad]; None where it has none."""
    if template.slides:
        return None
    radius = line_distance(template.motion.origin, template.motion.direction, template.p)
    p = template.p[radius > OUTER * np.percentile(radius, 90.0)]
    if len(p) < LEAST_POINTS:
        return None
    seen = cKDTree(p)
    share = {count: min(_landing(template, p, seen, s) for s in _turns(count)) for count in SPOKES}
    count = most_spokes(share)
    return None if count == 1 else 2 * np.pi / count


def _turns(count: int) -> tuple[float, float]:
    return 2 * np.pi / count, -2 * np.pi / count


def _landing(template: PartTemplate, p: np.ndarray, seen: cKDTree, s: float) -> float:
    """Share of points (n, 3) that a turn brings near to others of them."""
    X = template.pose(s)
    return float((seen.query(p @ X[:3, :3].T + X[:3, 3], distance_upper_bound=NEAR_M)[0] < NEAR_M).mean())
