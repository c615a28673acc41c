"""Level surfaces that a part covered in one of the views: the table behind an open lid, the keys under a shut one.

Each such piece is seen in one view only, so it could be the part itself, come from elsewhere. But it continues a level
surface that stayed, and a part does not come to rest inside of what carries it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.change import Change, Changes
from s2r_host.perception.evidence import Scene
from s2r_host.perception.planes import find_planes
from s2r_host.perception.view import View

Array = NDArray[np.floating]

LEVEL_COS = np.cos(np.radians(8.0))
ALONG_COS = np.cos(np.radians(20.0))  # normals of single pixels
CONTINUES_M = 0.003  # thinner than lids are
SAMPLE = 6000
NEAR_M = 0.6  # around what moved, as the table behind an open lid is seen far behind it
NOISE_SIGMAS = 2.0


def with_revealed_level(scene: Scene, up: Array | None, rng: np.random.Generator) -> Scene:
    """The scene with `Change.STATIC` for points of one view that continue a level surface seen in both."""
    if up is None or scene.small() or not len(scene.moved_points()):
        return scene
    low, high = np.percentile(scene.moved_points(), [2, 98], axis=0)
    box = low - NEAR_M, high + NEAR_M
    return replace(
        scene,
        changes=Changes(
            _labelled(scene.before, scene.changes.before, box, up, rng),
            _labelled(scene.after, scene.changes.after, box, up, rng),
        ),
    )


def _labelled(
    view: View, label: NDArray[np.uint8], box: tuple[Array, Array], up: Array, rng: np.random.Generator
) -> NDArray[np.uint8]:
    inside = view.normal_ok & ((view.points > box[0]) & (view.points < box[1])).all(axis=1)
    level = np.abs(view.normals @ up) > ALONG_COS
    stayed = np.flatnonzero(inside & level & (label == Change.STATIC))
    open_ = np.flatnonzero(inside & level & (label == Change.UNKNOWN))
    if len(stayed) < 100 or not len(open_):
        return label
    chosen = rng.permutation(stayed)[:SAMPLE]
    result = label.copy()
    for plane in find_planes(view.points[chosen], view.normals[chosen], rng, most=4):
        if abs(float(plane.normal @ up)) < LEVEL_COS:
            continue
        height = np.abs((view.points[open_] - plane.centre) @ plane.normal)
        within = np.maximum(CONTINUES_M, NOISE_SIGMAS * view.sigma_m[open_])
        result[open_[height < within]] = Change.STATIC
    return result
