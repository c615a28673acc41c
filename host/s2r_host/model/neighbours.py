"""What stands out of a cabinet around one of its drawers: other drawers that are open, with their handles.

A box around everything static would reach as far out as the neighbour that is open furthest, and fill the gap behind
the handle of the drawer that is moved. Frame D of :mod:`s2r_host.model.drawer`: x out of the cabinet, z up.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Corners = tuple[Array, Array]

STANDS_OUT_M = 0.012  # further than noise, and than a front that lies over the cabinet's edge
_SLICE_M = 0.004
_HANDLE_M = 0.008  # in front of a neighbour's own front


def neighbours_of(
    q: Array, around: Sequence[NDArray[np.bool_]], least_points: int
) -> tuple[float, tuple[Corners, ...]]:
    """Where the cabinet's own front is, and boxes for what stands out of it.

    Args:
        q: Static points, frame D [m], (n, 3).
        around: Which of them lie above, below, right and left of the drawer's front, each (n,).
        least_points: Sides with fewer points tell nothing.

    Returns:
        x of the cabinet's front [m], that of the side which stands out least where one stands out; corners of boxes, a
        front and what sticks out of it apart.
    """
    sides = [side for side in around if side.sum() >= least_points]
    fronts = [float(np.percentile(q[side, 0], 99)) for side in sides]
    if not fronts or max(fronts) - min(fronts) < STANDS_OUT_M:
        return float(np.percentile(q[np.logical_or.reduce(around), 0], 99)), ()
    cabinet = min(fronts)
    boxes: list[Corners] = []
    for side, front in zip(sides, fronts, strict=True):
        out = q[side & (q[:, 0] > cabinet + 0.5 * STANDS_OUT_M)]
        if front - cabinet >= STANDS_OUT_M and len(out) >= least_points:
            boxes += _front_and_handle(out, cabinet, least_points)
    return cabinet, tuple(boxes)


def _front_and_handle(out: Array, cabinet: float, least_points: int) -> list[Corners]:
    """Boxes around points that stand out: from the cabinet to their fullest layer, and what lies before that."""
    counts, edges = np.histogram(
        out[:, 0], bins=np.arange(cabinet, out[:, 0].max() + 2.0 * _SLICE_M, _SLICE_M)
    )
    face = float(edges[int(counts.argmax()) + 1])
    slab, handle = out[out[:, 0] <= face + _HANDLE_M], out[out[:, 0] > face + _HANDLE_M]
    boxes = [_around(slab, cabinet, face)]
    if len(handle) >= least_points:
        boxes.append(_around(handle, face, float(np.percentile(handle[:, 0], 99))))
    return boxes


def _around(points: Array, x_low: float, x_high: float) -> Corners:
    (y0, z0), (y1, z1) = np.percentile(points[:, 1:], [1, 99], axis=0)
    return np.array([x_low, y0, z0]), np.array([x_high, y1, z1])
