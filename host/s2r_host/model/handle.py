"""A handle in front of a face: a bar on posts with a free gap, or a knob.

The hidden back of the bar decides whether a finger fits behind it, so nothing is filled in: the bar is as thick as
its visible top or side says, and the space behind it stays open wherever no post was seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from s2r_host.model.pieces import Piece, box
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.frames import pixel_rays, project
from s2r_host.perception.view import DepthView

Array = NDArray[np.floating]

STANDS_OUT_M = 0.009
COLUMN_M = 0.006
LEAST_POINTS = 40
THINNEST_M, THICKEST_M = 0.006, 0.03


@dataclass(frozen=True, eq=False)
class Handle:
    """A handle in the frame of its face (x out of the face, z up) [m].

    Attributes:
        vertical: The bar runs along z instead of y.
        bar_low, bar_high: Corners of the bar.
        posts: Intervals along the bar where it is joined to the face.
        posts_seen: Whether posts were observed (else they are put at the ends).
        thickness_interval_m: 90 % interval of the bar's extent along x.
    """

    vertical: bool
    bar_low: Array
    bar_high: Array
    posts: tuple[tuple[float, float], ...]
    posts_seen: bool
    thickness_interval_m: tuple[float, float]

    @property
    def gap_m(self) -> float:
        """Free space between face and bar."""
        return float(self.bar_low[0])


def find_handle(
    q: Array, low: Array, high: Array, estimate: JointEstimate, X_base_face: Array
) -> Handle | None:
    """Find a handle among part points.

    Args:
        q: Part points in the face frame, shape (n, 3).
        low: Lower corner of the face slab, shape (3,).
        high: Upper corner of the face slab.
        estimate: For the views, in which the handle is fitted.
        X_base_face: Pose of the face frame.
    """
    inside = (q[:, 1:] > low[1:] - 0.01).all(axis=1) & (q[:, 1:] < high[1:] + 0.01).all(axis=1)
    p = q[inside & (q[:, 0] > STANDS_OUT_M) & (q[:, 0] < 0.12)]
    p = _largest_cluster(p)
    if len(p) < LEAST_POINTS:
        return None
    rough = _rough(p)
    return _fit(rough, low, high, estimate, X_base_face)


def handle_pieces(handle: Handle, X: Array) -> list[Piece]:
    """Bar and posts as boxes; the gap between them stays free."""
    pieces = [box("handle_bar", "part", X, handle.bar_low, handle.bar_high)]
    along = 2 if handle.vertical else 1
    for i, (a, b) in enumerate(handle.posts):
        low, high = handle.bar_low.copy(), handle.bar_high.copy()
        low[0], high[0] = 0.0, handle.bar_low[0]
        low[along], high[along] = a, b
        pieces.append(box(f"handle_post{i}", "part", X, low, high, seen=handle.posts_seen))
    return pieces


def _largest_cluster(p: Array) -> Array:
    """The largest group of points linked by 8 mm cells; what belongs to a second handle is left out."""
    if len(p) < LEAST_POINTS:
        return p
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    cell, inverse = np.unique(np.floor(p / 0.006).astype(np.int64), axis=0, return_inverse=True)
    tree = cKDTree(cell.astype(np.float64))
    _, label = connected_components(
        tree.sparse_distance_matrix(tree, 2.3, output_type="coo_matrix"), directed=False
    )
    of_point = label[inverse.ravel()]
    return p[of_point == np.bincount(of_point).argmax()]


def _rough(p: Array) -> Handle:
    """First guess from quantiles of the cluster."""
    outer = p[p[:, 0] > 0.5 * np.percentile(p[:, 0], 95)]
    spread = np.ptp(np.percentile(outer[:, 1:], [3, 97], axis=0), axis=0)
    vertical = bool(spread[1] > 1.3 * spread[0])
    along, across = (2, 1) if vertical else (1, 2)
    x_face = float(np.percentile(outer[:, 0], 90))
    a0, a1 = np.percentile(outer[:, along], [1.5, 98.5])
    bar = outer[outer[:, 0] > x_face - 0.012]
    c0, c1 = np.percentile(bar[:, across], [4, 96])
    posts, open_back = _posts(p, along, x_face, float(a0), float(a1))
    thick = float(np.clip(x_face - open_back, THINNEST_M, THICKEST_M)) if open_back else float(c1 - c0)
    low, high = np.zeros(3), np.zeros(3)
    low[0], high[0] = max(x_face - thick, 0.004), x_face
    low[along], high[along] = a0, a1
    low[across], high[across] = c0, max(c1, c0 + THINNEST_M)
    seen = bool(posts)
    width = float(np.clip(high[across] - low[across], 0.006, 0.02))
    if not posts:
        posts = [(float(a0), float(a0) + width), (float(a1) - width, float(a1))]
    return Handle(vertical, low, high, tuple(posts), seen, (THINNEST_M, THICKEST_M))


def _posts(
    p: Array, along: int, x_face: float, a0: float, a1: float
) -> tuple[list[tuple[float, float]], float]:
    """Where points fill the way from the face to the bar, and how far back the bar reaches elsewhere."""
    edges = np.arange(a0, a1 + COLUMN_M, COLUMN_M)
    joined, backs = [], []
    for lo, hi in pairwise(edges):
        column = p[(p[:, along] >= lo) & (p[:, along] < hi), 0]
        # A post fills the middle of the gap; stray points of a melted edge do not.
        middle = ((column > 0.35 * x_face) & (column < 0.65 * x_face)).sum()
        joined.append(len(column) > 0 and middle >= max(2, 0.12 * len(column)))
        if len(column) >= 4 and not joined[-1]:
            backs.append(np.percentile(column, 8))
    runs: list[tuple[float, float]] = []
    start: int | None = None
    for i, flag in enumerate([*joined, False]):
        if flag and start is None:
            start = i
        elif not flag and start is not None:
            runs.append((float(edges[start]), float(edges[min(i, len(edges) - 1)])))
            start = None
    if len(runs) and sum(b - a for a, b in runs) > 0.8 * (a1 - a0):
        return [(a0, a1)], 0.0  # a knob or a closed ledge
    return runs, float(np.median(backs)) if backs else 0.0


def _fit(rough: Handle, low: Array, high: Array, estimate: JointEstimate, X_base_face: Array) -> Handle:
    """Shift and size the bar until its picture agrees with both depth images, free gap included."""
    renders = [
        r for r in (
            _window(view, X, rough) for view, X in (
                (estimate.view_before, X_base_face),
                (estimate.view_after, estimate.motion.transform() @ X_base_face),
            ) if isinstance(view, DepthView)
        ) if r is not None
    ]  # fmt: skip
    if not renders:
        return rough
    start = np.concatenate([rough.bar_low, rough.bar_high])

    def cost(parameters: Array) -> float:
        a, b = parameters[:3], parameters[3:]
        thick = b - a
        if (thick < 0.003).any() or a[0] < 0.002:
            return 10.0
        handle = _with_bar(rough, a, b)
        # A weak wish for a bar as thick as it is high holds the thickness where nothing shows it.
        across = 1 if rough.vertical else 2
        wish = 0.02 * ((thick[0] - thick[across]) / 0.006) ** 2
        return wish + sum(_disagreement(handle, low, high, r) for r in renders) / len(renders)

    simplex = np.vstack([start, start + 0.003 * np.eye(6)])
    found = minimize(
        cost, start, method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 350, "xatol": 2e-4, "fatol": 1e-4},
    )  # fmt: skip
    if found.fun >= cost(start):
        found_low, found_high = rough.bar_low, rough.bar_high
    else:
        found_low, found_high = found.x[:3], found.x[3:]
    thick = float(found_high[0] - found_low[0])
    best = _with_bar(rough, found_low, found_high)
    return Handle(
        best.vertical, best.bar_low, best.bar_high, best.posts, best.posts_seen,
        (max(0.003, thick - 0.004), thick + 0.004),
    )  # fmt: skip


def _with_bar(handle: Handle, low: Array, high: Array) -> Handle:
    """The handle with another bar; posts follow the bar's ends."""
    along = 2 if handle.vertical else 1
    old_a, old_b = handle.bar_low[along], handle.bar_high[along]
    scale = (high[along] - low[along]) / max(old_b - old_a, 1e-6)

    def moved(value: float) -> float:
        return float(low[along] + (value - old_a) * scale)

    posts = tuple((max(moved(a), low[along]), min(moved(b), high[along])) for a, b in handle.posts)
    return Handle(handle.vertical, low, high, posts, handle.posts_seen, handle.thickness_interval_m)


@dataclass(frozen=True, eq=False)
class _Window:
    """Pixels around the handle: camera centre and rays (unit z) in the face frame, measured depth and noise."""

    origin: Array
    rays: Array
    depth: Array
    sigma: Array


def _window(view: DepthView, X_base_face: Array, handle: Handle) -> _Window | None:
    X_face_camera = np.linalg.inv(X_base_face) @ view.X_base_camera
    margin = 0.02
    corners = np.array(
        [[x, y, z] for x in (0.0, handle.bar_high[0] + margin)
         for y in (handle.bar_low[1] - margin, handle.bar_high[1] + margin)
         for z in (handle.bar_low[2] - margin, handle.bar_high[2] + margin)]
    )  # fmt: skip
    uv, z = project(corners, view.K, X_face_camera)
    if (z < 0.05).any():
        return None
    u0, v0 = np.floor(uv.min(axis=0)).astype(int)
    u1, v1 = np.ceil(uv.max(axis=0)).astype(int) + 1
    u0, v0 = max(u0, 0), max(v0, 0)
    u1, v1 = min(u1, view.shape[1]), min(v1, view.shape[0])
    if u1 - u0 < 5 or v1 - v0 < 3:
        return None
    u, v = np.meshgrid(np.arange(u0, u1), np.arange(v0, v1))
    depth = view.depth[v0:v1, u0:u1].ravel()
    ray_C = pixel_rays(view.K, u, v)
    keep = depth > 0
    keep[np.flatnonzero(keep)] &= np.arange(int(keep.sum())) % max(1, int(keep.sum()) // 6000) == 0
    rays = ray_C.reshape(-1, 3)[keep] @ X_face_camera[:3, :3].T
    from s2r_host.perception.view import noise_sigma

    return _Window(X_face_camera[:3, 3], rays, depth[keep], noise_sigma(depth[keep], view.noise_scale))


def _disagreement(handle: Handle, low: Array, high: Array, window: _Window) -> float:
    """Mean capped deviation of the predicted from the measured depth over the pixels that hit face or handle."""
    boxes = [(handle.bar_low, handle.bar_high), (low, high)]
    along = 2 if handle.vertical else 1
    for a, b in handle.posts:
        post_low, post_high = handle.bar_low.copy(), handle.bar_high.copy()
        post_low[0], post_high[0] = 0.0, handle.bar_low[0]
        post_low[along], post_high[along] = a, b
        boxes.append((post_low, post_high))
    predicted = np.full(len(window.depth), np.inf)
    inverse = 1.0 / np.where(np.abs(window.rays) < 1e-9, 1e-9, window.rays)
    for a, b in boxes:
        t1, t2 = (a - window.origin) * inverse, (b - window.origin) * inverse
        near, far = np.minimum(t1, t2), np.maximum(t1, t2)
        enter = np.maximum(np.maximum(near[:, 0], near[:, 1]), near[:, 2])
        leave = np.minimum(np.minimum(far[:, 0], far[:, 1]), far[:, 2])
        hit = (leave > enter) & (enter > 0)
        predicted = np.where(hit, np.minimum(predicted, enter), predicted)
    known = np.isfinite(predicted)
    if not known.any():
        return 1.0
    deviation = np.abs(predicted[known] - window.depth[known]) / (3.0 * window.sigma[known] + 0.002)
    return float(np.minimum(deviation, 2.0).mean())
