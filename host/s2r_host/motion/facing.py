"""Levers that point at the camera: of them little more is seen than their end, which hangs before the body."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from s2r_host.motion.levers import FOOT_M, MOST_WIDTH_M, LeverCandidate, on_body
from s2r_host.motion.scene import Scene
from s2r_host.motion.standing import COLUMN_RADIUS_M, standing_on

LONGEST_M = 0.22
ASIDE_RAD = np.radians(30.0)  # from the way to the camera, seen from above
TOP_M = 0.01  # the lever leaves its hub so far below the top of that
HALF = 0.5


def find_facing(scene: Scene, known: Sequence[np.ndarray]) -> list[LeverCandidate]:
    """What may be the end of a lever on top of the body, the one with most points first; maybe none.

    Args:
        scene: Observed points.
        known: Points of other candidates [m], (n, 3) each.
    """
    standing, found = standing_on(scene), []
    if standing is None:
        return []
    at_body = np.linalg.norm(standing.above[:, :2] - standing.p_body, axis=1) <= COLUMN_RADIUS_M
    if not at_body.any():
        return []
    top_m = float(np.percentile(standing.above[at_body, 2], 98.0))
    towards = (scene.p_camera[:2] - standing.p_body) / np.linalg.norm(scene.p_camera[:2] - standing.p_body)
    taken = cKDTree(np.concatenate(known)) if known else None
    for piece in standing.apart:
        middle = np.median(piece, axis=0)
        out = middle[:2] - standing.p_body
        away_m = float(np.linalg.norm(out))
        if (
            np.ptp(piece, axis=0).max() > MOST_WIDTH_M
            or piece[:, 2].min() < standing.deck_m + FOOT_M
            or away_m > LONGEST_M
            or float(out @ towards) < np.cos(ASIDE_RAD) * away_m
            or (taken is not None and (taken.query(piece)[0] == 0.0).mean() > HALF)
        ):
            continue
        aside = np.array([out[1], -out[0], 0.0]) / away_m
        width_m = float(np.ptp(np.percentile(piece @ aside, [2.0, 98.0])))
        found.append(on_body(piece, min(top_m - TOP_M, float(middle[2])), middle, width_m, standing))
    return sorted(found, key=lambda one: -len(one.p))
