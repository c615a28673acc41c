"""The points of two views around what changed between them, as the pair network sees them.

Everything here is numpy, so that training and use prepare their input by the same code. Whether a point left, stayed or
was out of sight of the other view comes from `change.compare`: free space tells that better than nearness of points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.change import Change
from s2r_host.perception.evidence import Scene
from s2r_host.perception.verdict import require_motion
from s2r_host.perception.view import View

Array = NDArray[np.floating]
Index = NDArray[np.int64]

POINTS = 384  # per view
COARSE = (96, 32)  # points of the two coarser levels, per view
NEIGHBOURS = 10
FEATURES = 11
MOST_GAP_M = 0.15  # beyond it the gap says no more
MARGIN_M = 0.15  # around what moved; as much as the search for planes looks at
POOLED = {Change.MOVED: 1536, Change.UNKNOWN: 768, Change.STATIC: 1024}  # most points kept of a view
SHARES = {
    Change.MOVED: 0.45,
    Change.UNKNOWN: 0.25,
    Change.STATIC: 0.3,
}  # of a sample, where there are as many


@dataclass(frozen=True, eq=False)
class Pool:
    """Points of one view near what changed, from which samples are drawn.

    Attributes:
        points: [m], frame of the views, shape (n, 3).
        normals: Unit, towards the camera, shape (n, 3).
        change: `Change` labels, uint8, shape (n,).
        edge, normal_ok: See `view.View`, shape (n,).
        gap_m: How far behind the point the other view's surface lies on its ray, 0 where it has none, shape (n,).
        index: Into the points of the view, shape (n,).
    """

    points: Array
    normals: Array
    change: NDArray[np.uint8]
    edge: NDArray[np.bool_]
    normal_ok: NDArray[np.bool_]
    gap_m: Array
    index: Index


@dataclass(frozen=True, eq=False)
class PairPool:
    """Both views' points.

    Attributes:
        before, after: One pool each.
        centre: Middle of what moved [m], shape (3,).
        heading: Where the first camera stands seen from there, about the vertical, 0 along x [rad].
    """

    before: Pool
    after: Pool
    centre: Array
    heading: float

    def one_sided(self) -> bool:
        """Whether one of the views shows nothing there, as where a region holds points of the other one only."""
        return not (len(self.before.points) and len(self.after.points))


@dataclass(frozen=True, eq=False)
class PairCloud:
    """A sample of both views; the first axis is (before, after), P = `POINTS`, in random order.

    Attributes:
        points: [m], shape (2, P, 3).
        normals: Shape (2, P, 3).
        flags: Edge, normal fits, moved, static, as 0 or 1, shape (2, P, 4).
        gap_m: See `Pool`, shape (2, P).
        chosen: Which points of the pools, shape (2, P).
        centre, heading: See `PairPool`.
    """

    points: Array
    normals: Array
    flags: NDArray[np.float32]
    gap_m: Array
    chosen: Index
    centre: Array
    heading: float

    def features(self) -> NDArray[np.float32]:
        """Input of the network: centred points [dm], normals, flags, gap [dm]; (2, P, `FEATURES`)."""
        columns = (10 * (self.points - self.centre), self.normals, self.flags, 10 * self.gap_m[..., None])
        return np.concatenate(columns, axis=2).astype(np.float32)


def pool(scene: Scene, rng: np.random.Generator) -> PairPool:
    """Points near what changed between two views.

    Raises:
        NothingMovedError: Hardly anything did.
    """
    require_motion(scene)
    low, high = np.percentile(scene.moved_points(), [2, 98], axis=0)
    box = low - MARGIN_M, high + MARGIN_M
    return PairPool(
        _near(scene.before, scene.after, scene.changes.before, scene.candidate_before, box, rng),
        _near(scene.after, scene.before, scene.changes.after, scene.candidate_after, box, rng),
        0.5 * (low + high),
        heading(scene.before.p_camera, 0.5 * (low + high)),
    )


def heading(p_camera: Array | None, centre: Array) -> float:
    """See `PairPool`; 0 where no camera is known."""
    if p_camera is None:
        return 0.0
    return float(np.arctan2(p_camera[1] - centre[1], p_camera[0] - centre[0]))


def facing(angle: float) -> Array:
    """Rotation (3, 3) about the vertical that brings a camera at heading ``angle`` [rad] to the x axis.

    The network sees pairs in this frame: fronts of things mostly look towards the camera, and what need not be learnt
    for every heading is learnt from fewer pairs.
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def sample(pools: PairPool, rng: np.random.Generator) -> PairCloud:
    """`POINTS` points of each view: of each label its share, and what one lacks the others give.

    Neither view may be without points (`PairPool.one_sided`).
    """
    views = (pools.before, pools.after)
    chosen = np.stack([_draw(view.change, rng) for view in views])
    points, normals, flags = [], [], []
    for view, at in zip(views, chosen, strict=True):
        points.append(view.points[at])
        normals.append(view.normals[at])
        change = view.change[at]
        columns = (view.edge[at], view.normal_ok[at], change == Change.MOVED, change == Change.STATIC)
        flags.append(np.stack(columns, axis=1))
    return PairCloud(
        np.stack(points),
        np.stack(normals),
        np.stack(flags).astype(np.float32),
        np.stack([view.gap_m[at] for view, at in zip(views, chosen, strict=True)]),
        chosen,
        pools.centre,
        pools.heading,
    )


def _near(
    view: View,
    other: View,
    change: NDArray[np.uint8],
    candidate: NDArray[np.bool_],
    box: tuple[Array, Array],
    rng: np.random.Generator,
) -> Pool:
    inside = candidate & np.all((view.points >= box[0]) & (view.points <= box[1]), axis=1)
    kept = []
    for label, most in POOLED.items():
        index = np.flatnonzero(inside & (change == label))
        kept.append(index if len(index) <= most else rng.choice(index, most, replace=False))
    at = np.concatenate(kept)
    gap = other.look(view.points[at], view.sigma_m[at]).gap_m
    return Pool(
        view.points[at],
        view.normals[at],
        change[at],
        view.edge[at],
        view.normal_ok[at],
        np.clip(gap, -MOST_GAP_M, MOST_GAP_M),
        at.astype(np.int64),
    )


def _draw(change: NDArray[np.uint8], rng: np.random.Generator) -> Index:
    order = [rng.permutation(np.flatnonzero(change == label)) for label in SHARES]
    count = [
        min(len(index), round(POINTS * SHARES[label])) for label, index in zip(SHARES, order, strict=True)
    ]
    for k, index in enumerate(order):
        count[k] = min(len(index), count[k] + POINTS - sum(count))
    at = np.concatenate([index[:n] for index, n in zip(order, count, strict=True)])
    if len(at) < POINTS:
        # A view that shows hardly anything there: points come twice.
        at = np.concatenate([at, rng.choice(at, POINTS - len(at))])
    return rng.permutation(at)
