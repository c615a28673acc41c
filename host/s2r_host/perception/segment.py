"""Which points belong to the moving part, once the motion is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from s2r_host.perception.change import Change
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.view import Seen, View, agreement

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

PIECE_CELL_M = 0.03
APART_M = 0.2  # what hides a stretch of a part is not wider
NORMAL_LENGTH_M = 0.03  # a right angle between normals counts like 4 cm of distance


@dataclass(frozen=True, eq=False)
class Parts:
    """Masks over the points of both views."""

    before: Mask
    after: Mask


def segment(scene: Scene, motion: JointMotion) -> Parts:
    """Split both views into the moving part and the rest."""
    X = motion.transform()
    before = _one(
        scene.before, scene.changes.before, scene.candidate_before, scene.after, scene.changes.after, X
    )
    after = _one(
        scene.after,
        scene.changes.after,
        scene.candidate_after,
        scene.before,
        scene.changes.before,
        np.linalg.inv(X),
    )
    return Parts(before, after)


def _one(
    view: View,
    label: NDArray[np.uint8],
    candidate: Mask,
    other: View,
    other_label: NDArray[np.uint8],
    X: Array,
) -> Mask:
    p = view.points @ X[:3, :3].T + X[:3, 3]
    travel = np.linalg.norm(p - view.points, axis=1)
    found = other.look(p, view.sigma_m, extra_m=0.002)
    index = np.maximum(found.index, 0)
    lands = (found.seen == Seen.SURFACE) & (other_label[index] != Change.STATIC)
    turned = view.normals @ X[:3, :3].T
    aligned = agreement(turned, other.normals[index], view.oriented and other.oriented) > 0.8
    lands &= aligned | ~(view.normal_ok & other.normal_ok[index])
    hidden = (found.seen == Seen.HIDDEN) | (found.seen == Seen.NO_RETURN) | (found.seen == Seen.OUT)
    visible_motion = travel > 3.0 * view.sigma_m
    part = candidate & (lands & (label != Change.STATIC))
    part |= candidate & (label == Change.MOVED) & hidden
    rest = (label == Change.STATIC) & visible_motion & ~_slides_in_itself(view, X, travel)
    rest |= (label == Change.MOVED) & (found.seen == Seen.FREE)
    part = _keep_large(view, part)
    rest &= ~part
    return _vote(view, part, rest, candidate)


def _keep_large(view: View, part: Mask) -> Mask:
    """Drop pieces that hang together over 3 cm cells but hold less than 5 % of the part, or lie far from its largest.

    A lever has so few points that ghosts on the table a metre behind it hold more than 5 % of them.
    """
    if not part.any():
        return part
    p = view.points[part]
    cell, inverse = np.unique(np.floor(p / PIECE_CELL_M).astype(np.int64), axis=0, return_inverse=True)
    tree = cKDTree(cell.astype(np.float64))
    _, label = connected_components(
        tree.sparse_distance_matrix(tree, 1.8, output_type="coo_matrix"), directed=False
    )
    of_point = label[inverse.ravel()]
    size = np.bincount(of_point)
    largest = cKDTree(cell[label == int(size.argmax())].astype(np.float64))
    near = largest.query(cell.astype(np.float64))[0] * PIECE_CELL_M < APART_M
    result = part.copy()
    result[np.flatnonzero(part)] = (size[of_point] >= max(30, 0.05 * len(p))) & near[inverse.ravel()]
    return result


def _slides_in_itself(view: View, X: Array, travel: Array) -> Mask:
    """Points whose motion lies within their own surface: looking unchanged says nothing about them."""
    step = view.points @ X[:3, :3].T + X[:3, 3] - view.points
    across = np.abs(np.einsum("ni,ni->n", step, view.normals))
    return view.normal_ok & (across < 3.0 * view.sigma_m) & (travel > 0)


def _vote(view: View, part: Mask, rest: Mask, candidate: Mask) -> Mask:
    """Undecided points take the majority of their five nearest decided neighbours."""
    undecided = candidate & ~part & ~rest
    if not part.any():
        return part
    low, high = np.percentile(view.points[part], [1, 99], axis=0)
    near = undecided & ((view.points > low - 0.04) & (view.points < high + 0.04)).all(axis=1)
    around = rest & ((view.points > low - 0.08) & (view.points < high + 0.08)).all(axis=1)
    result = part.copy()
    if not near.any() or not around.any():
        return result
    decided = np.concatenate([np.flatnonzero(part), np.flatnonzero(around)])
    features = np.concatenate([view.points, NORMAL_LENGTH_M * view.normals], axis=1)
    _, neighbour = cKDTree(features[decided]).query(features[near], k=min(5, len(decided)))
    result[np.flatnonzero(near)] = (neighbour < int(part.sum())).mean(axis=1) > 0.5
    return result
