"""What changed between two views: moved for sure, static for sure, or unknown."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from s2r_host.perception.colour_change import colour_changed
from s2r_host.perception.view import DepthView, Seen, View

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

PIECE_M = 0.03
LEAST_PIECE = 100  # points of the largest piece of a view that is small beside the other view's
LEAST_SHARE = 0.15  # of the largest moved piece; smaller ones count only beside it
BESIDE_M = 0.12
SHADOW_PX, BEFORE_M = (
    30,
    0.03,
)  # how wide the shadows of what is near are; how far before its surroundings it stands
SURE_M = 0.005  # how much deeper than the noise band the other view must see to call a point moved


class Change(enum.IntEnum):
    """Label of a point of one view with respect to the other view."""

    UNKNOWN = 0  # hidden, out of sight or no return in the other view
    STATIC = 1  # the other view sees a surface there too
    MOVED = 2  # the other view saw through the place: the surface left it


@dataclass(frozen=True, eq=False)
class Changes:
    """Labels (`Change`, uint8) per point of both views."""

    before: NDArray[np.uint8]
    after: NDArray[np.uint8]


def compare(before: View, after: View) -> Changes:
    """Label every point of both views against the other one."""
    return Changes(_label(before, after), _label(after, before))


def with_shadows(before: View, after: View, changes: Changes) -> Changes:
    """With what moved by its colours: beside and behind what is near, stereo cameras return nothing.

    Where one view has a surface before what is around it and the other, from the same place, no return but another
    colour, the surface was not there.
    """
    if not isinstance(before, DepthView) or not isinstance(after, DepthView):
        return changes
    labels = []
    for view, other, label in ((before, after, changes.before), (after, before, changes.after)):
        shadow = _clean_image(_left_a_shadow(view, other), view)
        labels.append(np.where(shadow, Change.MOVED, label).astype(np.uint8))
    return Changes(*labels)


def without_specks(before: View, after: View, changes: Changes) -> Changes:
    """Call small moved pieces far from the large ones unknown: at a few metres a stereo camera sees ghosts."""
    parts = ((before, changes.before), (after, changes.after))
    index = [np.flatnonzero(label == Change.MOVED) for _, label in parts]
    points = np.concatenate([view.points[i] for (view, _), i in zip(parts, index, strict=True)])
    if len(points) < 30:
        return changes
    grid = np.floor(points / PIECE_M).astype(np.int64)
    grid -= grid.min(axis=0)
    size = tuple(int(n) for n in grid.max(axis=0) + 1)
    # One number per cell: sorting rows takes ten times as long.
    number, inverse = np.unique(np.ravel_multi_index(tuple(grid.T), size), return_inverse=True)
    tree = cKDTree(np.stack(np.unravel_index(number, size), axis=1).astype(np.float64))
    _, piece_of_cell = connected_components(
        tree.sparse_distance_matrix(tree, 1.8, output_type="coo_matrix"), directed=False
    )
    piece = piece_of_cell[inverse.ravel()]
    weight = np.bincount(piece)
    large = (weight >= LEAST_SHARE * weight.max())[piece]
    for own in np.split(np.arange(len(piece)), [len(index[0])]):
        # A door seen edge-on in one view is a small piece there, and all there is.
        if len(own) and not large[own].any():
            count = np.bincount(piece[own])
            if count.max() >= LEAST_PIECE:
                large[own] = piece[own] == np.argmax(count)
    keep = large.copy()
    if not large.all():
        # Few points far from very many: a tight tree, which looks at nearly all of them, takes sixty times as long.
        tree = cKDTree(points[large], balanced_tree=False, compact_nodes=False)
        distance, _ = tree.query(points[~large], distance_upper_bound=BESIDE_M)
        keep[~large] = np.isfinite(distance)
    cleaned = []
    for (_, label), i, kept in zip(parts, index, np.split(keep, [len(index[0])]), strict=True):
        copy = label.copy()
        copy[i[~kept]] = Change.UNKNOWN
        cleaned.append(copy)
    return Changes(*cleaned)


def _label(view: View, other: View) -> NDArray[np.uint8]:
    found = other.look(view.points, view.sigma_m)
    label = np.full(len(view.points), Change.UNKNOWN, dtype=np.uint8)
    label[found.seen == Seen.SURFACE] = Change.STATIC
    sure = other.look(view.points, view.sigma_m, extra_m=SURE_M).seen
    if isinstance(view, DepthView):
        moved = _clean_image(sure == Seen.FREE, view)
    else:
        # Without a camera "nothing near" is all there is: moved or hidden. Treated as moved, with less trust.
        far = (sure == Seen.OUT) | (sure == Seen.NO_RETURN)
        moved = _clean_cloud(far, view)
    label[moved] = Change.MOVED
    return label


def _left_a_shadow(view: DepthView, other: DepthView) -> Mask:
    """Which points stand before what the other view shows around their pixel, where itself it shows but a colour."""
    changed = colour_changed(view, other)
    if changed is None:
        return np.zeros(len(view.points), bool)
    window = np.ones((2 * SHADOW_PX + 1,) * 2, np.uint8)
    around = cv2.dilate(other.depth, window).ravel()[view.flat]
    z = view.depth.ravel()[view.flat]
    empty = (other.depth.ravel()[view.flat] <= 0.0) & ~other.ignored.ravel()[view.flat]
    return np.asarray(changed.ravel()[view.flat] & empty & (z < around - BEFORE_M))


def _clean_image(moved: Mask, view: DepthView) -> Mask:
    """Drop specks and one-pixel rims (depth edges jitter by a pixel)."""
    image = np.zeros(view.shape[0] * view.shape[1], np.uint8)
    image[view.flat] = moved
    image = image.reshape(view.shape)
    opened = cv2.morphologyEx(image, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(opened, connectivity=8)
    keep = np.zeros(count, bool)
    keep[1:] = stats[1:, cv2.CC_STAT_AREA] >= 30
    return keep[np.asarray(labels, dtype=np.int64)].ravel()[view.flat]


def _clean_cloud(moved: Mask, view: View) -> Mask:
    """Keep moved points most of whose neighbours moved too."""
    if not moved.any():
        return moved
    _, neighbour = cKDTree(view.points).query(view.points[moved], k=12)
    keep = moved[neighbour].mean(axis=1) > 0.6
    result = moved.copy()
    result[np.flatnonzero(moved)[~keep]] = False
    return result


def measured_noise_scale(before: DepthView, after: DepthView) -> float:
    """Ratio of the frame-to-frame depth noise to the model, from pixels of two equal cameras.

    Only temporal noise shows up here, so the result is bounded below by 1: the fixed pattern of a camera's errors
    shifts across a part that moves.
    """
    both = (before.depth > 0) & (after.depth > 0)
    difference = (after.depth - before.depth)[both]
    sigma = np.sqrt(2.0) * (0.0004 + 0.0014 * before.depth[both] ** 2)
    ratio = np.abs(difference / sigma)
    calm = ratio[ratio < 4.0]
    if calm.size < 500:
        return 1.0
    return float(np.clip(np.median(calm) / 0.6745, 1.0, 2.5))
