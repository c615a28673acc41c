"""A lever: a straight bar that stands out from its hub. Its sides matter, for they are what gets pushed.

Cameras show one or two sides of a bar, fattened at the edges by the matching window. The flat pieces that suit lids and
fronts make of it a broad thin plate with splinters around it; a box along its line is nearer to what a fingertip meets.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_host.model.pieces import Piece, box
from s2r_host.model.points import ObservedObject

Array = NDArray[np.floating]

HUB_M = 0.03  # about the axis, where hub and column are
LINE_M = 0.022  # points this near to the line are the bar's
LEAST_SHARE = 0.6  # of the points outside of the hub
LEAST_LENGTH_M, MOST_WIDTH_M = 0.045, 0.055
LEAST_SLENDER = 2.0  # length over width
FAT_M = 0.0025  # by which an outline is too wide on each side
TRIM = 2.0  # percent of the points beyond either side, which are stray
THINNEST_M, THICKEST_M = 0.008, 0.028
FIT_STEPS = 6
LEAST_POINTS = 150


def bar_pieces(seen: ObservedObject, p_axis: Array, axis: Array) -> list[Piece] | None:
    """A box for the bar and one for its hub, or None where the part is no bar.

    Args:
        seen: The part, in the pose of the first view.
        p_axis, axis: A point on the hinge's axis [m] and its unit vector, (3,) each.
    """
    if seen.p_camera is None:
        return None
    offset = seen.part - p_axis
    radius = np.linalg.norm(offset - np.outer(offset @ axis, axis), axis=1)
    out = seen.part[radius > HUB_M]
    fit = _line(out)
    if fit is None:
        return None
    centre, along, near = fit
    view = centre - seen.p_camera
    depth = view - (view @ along) * along
    depth /= np.linalg.norm(depth)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = np.column_stack([along, np.cross(depth, along), depth]), centre
    local = (out[near] - centre) @ X[:3, :3]
    low, high = np.percentile(local, [TRIM, 100.0 - TRIM], axis=0)
    width = max(float(high[1] - low[1]) - 2.0 * FAT_M, THINNEST_M)
    length = float(high[0] - low[0])
    if length < LEAST_LENGTH_M or width > MOST_WIDTH_M or length < LEAST_SLENDER * width:
        return None
    middle = 0.5 * (low[1] + high[1])
    front = float(np.percentile(local[np.abs(local[:, 1] - middle) < 0.25 * width][:, 2], 20.0))
    back = max(float(high[2]) - FAT_M, front + float(np.clip(width, THINNEST_M, THICKEST_M)))
    ends = np.percentile(local[:, 0], [1.0, 99.0])
    sides = middle - 0.5 * width, middle + 0.5 * width
    bar = box("bar", "part", X, np.array([ends[0], sides[0], front]), np.array([ends[1], sides[1], back]))
    return [bar, *_hub(seen.part[radius <= HUB_M], p_axis, axis)]


def _line(p: Array) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """Centre, unit vector and points of the line that most of some points lie near; None if there is none."""
    if len(p) < LEAST_POINTS:
        return None
    near = np.ones(len(p), dtype=bool)
    centre, along = p.mean(axis=0), np.zeros(3)
    for _ in range(FIT_STEPS):
        if near.sum() < LEAST_POINTS:
            return None
        centre = np.median(p[near], axis=0)
        along = np.linalg.eigh(np.cov((p[near] - centre).T))[1][:, 2]
        off = (p - centre) - np.outer((p - centre) @ along, along)
        near = np.linalg.norm(off, axis=1) < LINE_M
    return (centre, along, near) if near.mean() > LEAST_SHARE else None


def _hub(p: Array, p_axis: Array, axis: Array) -> list[Piece]:
    """A square block about the axis as high as what was seen there; none if that is next to nothing."""
    if len(p) < LEAST_POINTS:
        return []
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = np.column_stack([x, np.cross(axis, x), axis]), p_axis
    local = (p - p_axis) @ X[:3, :3]
    low, high = np.percentile(local[:, 2], [TRIM, 100.0 - TRIM])
    half = float(np.clip(np.percentile(np.linalg.norm(local[:, :2], axis=1), 80.0), 0.008, HUB_M)) / np.sqrt(
        2.0
    )
    return [box("hub", "part", X, np.array([-half, -half, low]), np.array([half, half, high]))]
