"""How well a one-joint motion explains both views, free space included.

Every point that moved for sure is carried into the other view. It should land on a surface that was not there
before. Landing behind a seen surface proves nothing; landing where the camera looked through, or on a surface
that did not change, speaks against the motion, unless a flat thing slides over its own former place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.change import Change, Changes
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.planes import find_planes
from s2r_host.perception.view import Seen, View, agreement

Array = NDArray[np.floating]

COST_FREE = 1.2
COST_STATIC = 0.8
COST_NORMAL = 0.7
COST_UNSEEN = 0.55
COST_OVER_ITSELF = 0.1  # a plate that slides within its own plane covers where it was: nothing changes there
# A lever that turns by less than it is wide lands on its own former place, too, which is there before and after. What
# it lands on then goes on to where the lever is as well.
COST_ON_ITSELF = 0.3
COST_THROUGH = 0.5  # it cannot pass through another one in that plane on its way, though
COST_INSIDE = 0.65  # behind a surface that did not change, so perhaps inside a solid
COST_FOREIGN = 0.6  # per point of a patch that the motion does not explain at all: a hand, a cable, a shadow
PATCH_M = 0.05
SMALL_M = 0.25  # diagonal of where a small part was and is
COST_ON_SURFACE = 0.35  # at the rim of the tolerance band; 0 at its centre
COST_BACK = 0.2  # behind a new surface that faces the other way: the far face of a plate that turned over
OTHER_FACE_COS = 0.5  # below it two surfaces are not the same face of a part
THICKEST_M = 0.03  # of a plate that shows one face before and the other after


@dataclass(frozen=True, eq=False)
class Probe:
    """A sample of surely moved points of one view with what is needed to carry them over.

    ``patch`` (n, patches) says which flat piece or which 5 cm cell a point belongs to, one 1 per row. A patch is
    explained or foreign as a whole: so the free space that a slipped plate violates is not outvoted by a hand.
    """

    points: Array
    normals: Array
    normal_ok: NDArray[np.bool_]
    sigma_m: Array
    patch: Array
    oriented: bool


@dataclass(frozen=True, eq=False)
class Scene:
    """Two views, their change labels, and the region in which motion is looked for."""

    before: View
    after: View
    changes: Changes
    candidate_before: NDArray[np.bool_]
    candidate_after: NDArray[np.bool_]

    def moved_before(self) -> NDArray[np.int64]:
        """Indices of surely moved points of the first view inside the region."""
        return np.flatnonzero((self.changes.before == Change.MOVED) & self.candidate_before)

    def moved_after(self) -> NDArray[np.int64]:
        """Indices of surely moved points of the second view inside the region."""
        return np.flatnonzero((self.changes.after == Change.MOVED) & self.candidate_after)

    def moved_points(self) -> Array:
        """Surely moved points of both views [m], (n, 3)."""
        return np.concatenate(
            [self.before.points[self.moved_before()], self.after.points[self.moved_after()]]
        )

    def small(self) -> bool:
        """Whether what moved is no larger than a tap's handle: no lid, no door, no drawer's front."""
        p = self.moved_points()
        if not len(p):
            return False
        low, high = np.percentile(p, [2, 98], axis=0)
        return bool(np.linalg.norm(high - low) < SMALL_M)


def probe(view: View, index: NDArray[np.int64], most: int, rng: np.random.Generator) -> Probe:
    """A random sample of at most ``most`` of the given points."""
    chosen = index if len(index) <= most else rng.choice(index, most, replace=False)
    p, n = view.points[chosen], view.normals[chosen]
    return Probe(
        p,
        n,
        view.normal_ok[chosen],
        view.sigma_m[chosen],
        _patches(p, n, view.normal_ok[chosen], rng),
        view.oriented,
    )


def _patches(p: Array, n: Array, ok: NDArray[np.bool_], rng: np.random.Generator) -> Array:
    if len(p) == 0:
        return np.zeros((0, 0))
    number = np.full(len(p), -1)
    flat = np.flatnonzero(ok)
    if len(flat) >= 60:
        for k, plane in enumerate(find_planes(p[flat], n[flat], rng, most=4)):
            near = np.abs((p - plane.centre) @ plane.normal) < 0.006
            near &= ~ok | (np.abs(n @ plane.normal) > 0.9)
            number[near & (number < 0)] = k
    cell = np.floor(p / PATCH_M).astype(np.int64)
    _, cell_number = np.unique(cell, axis=0, return_inverse=True)
    number = np.where(number >= 0, number, 10 + cell_number.ravel())
    _, number = np.unique(number, return_inverse=True)
    return np.eye(int(number.max()) + 1)[number]


def subset(part: Probe, keep: NDArray[np.bool_]) -> Probe:
    """The kept points of a sample."""
    return Probe(
        part.points[keep], part.normals[keep], part.normal_ok[keep], part.sigma_m[keep], part.patch[keep],
        part.oriented,
    )  # fmt: skip


def thinned(part: Probe, most: int) -> Probe:
    """Every k-th point of a sample, at most about ``most`` of them."""
    keep = np.zeros(len(part.points), dtype=bool)
    keep[:: max(1, -(-len(part.points) // most))] = True
    return subset(part, keep)


def carry(
    X: Array, part: Probe, view: View, label: NDArray[np.uint8], extra_m: float, *, small: bool = False
) -> Array:
    """Cost per hypothesis and point.

    Args:
        X: Transforms into the view, shape (hypotheses, 4, 4).
        part: Points to carry.
        view: The view they are carried into.
        label: Change labels of that view's points.
        extra_m: Widening of the surface band (coarse grids need it).
        small: The part is a lever, which may land on itself.

    Returns:
        Costs, shape (hypotheses, points).
    """
    turned = X[:, :3, :3].transpose(0, 2, 1)  # by matmul: einsum's plain loops took a fifth of an estimate
    p = part.points @ turned + X[:, None, :3, 3]
    n = part.normals @ turned
    h, m = p.shape[:2]
    sigma = np.broadcast_to(part.sigma_m, (h, m)).ravel()
    found = view.look(p.reshape(-1, 3), sigma, extra_m)
    index = np.maximum(found.index, 0)
    cost = np.full(h * m, COST_UNSEEN)
    cost[found.seen == Seen.FREE] = COST_FREE
    cost[(found.seen == Seen.HIDDEN) & (label[index] == Change.STATIC)] = COST_INSIDE
    surface = found.seen == Seen.SURFACE
    band = 3.0 * np.hypot(view.sigma_m[index], sigma) + extra_m
    target_n = view.normals[index]
    # Gap across the surface, not along the ray, so that steep surfaces are judged fairly.
    offset = np.abs(np.einsum("ni,ni->n", p.reshape(-1, 3) - view.points[index], target_n))
    reach = np.where(view.normal_ok[index], np.minimum(offset / band, 1.0), 0.7)
    cost[surface] = COST_ON_SURFACE * reach[surface] ** 2
    cosine = agreement(n.reshape(-1, 3), target_n, view.oriented and part.oriented)
    both_ok = np.broadcast_to(part.normal_ok, (h, m)).ravel() & view.normal_ok[index]
    cost[surface & both_ok & (cosine < 0.8)] = COST_NORMAL
    static = surface & (label[index] == Change.STATIC)
    cost[static] = COST_STATIC
    if small:
        cost[_on_itself(X, p, sigma, static, view, extra_m)] = COST_ON_ITSELF
    cost[static & both_ok & (cosine > 0.95) & _in_plane(X, n)] = COST_OVER_ITSELF
    if view.oriented and part.oriented:
        behind = -np.einsum("ni,ni->n", p.reshape(-1, 3) - view.points[index], target_n)
        back = both_ok & (surface | (found.seen == Seen.HIDDEN)) & (cosine < -0.8)
        back &= (label[index] != Change.STATIC) & (behind > -band) & (behind < THICKEST_M + band)
        cost[back] = COST_BACK
    return cost.reshape(h, m)


def _on_itself(
    X: Array, p: Array, sigma: Array, static: NDArray[np.bool_], view: View, extra_m: float
) -> NDArray[np.bool_]:
    """Of carried points (h, m, 3) that met a surface which is there in both views, those that met their own part.

    What they met would belong to the part: carried as well it has to be on a surface again. Flat (h × m,).
    """
    found = np.flatnonzero(static)
    if not len(found):
        return static
    motion = X[found // p.shape[1]]
    met = p.reshape(-1, 3)[found]
    on = np.einsum("kij,kj->ki", motion[:, :3, :3], met) + motion[:, :3, 3]
    again = np.zeros_like(static)
    again[found] = view.look(on, sigma[found], extra_m).seen == Seen.SURFACE
    return again


def _in_plane(X: Array, n: Array) -> NDArray[np.bool_]:
    """Which carried points slide within their own surface, flat (h × m,); ``n`` (h, m, 3) are their normals."""
    way = X[:, :3, 3]
    length = np.linalg.norm(way, axis=1)
    slides = (np.abs(X[:, :3, :3] - np.eye(3)).max(axis=(1, 2)) < 1e-9) & (length > 1e-9)
    across = np.abs(np.einsum("hmi,hi->hm", n, way)) / np.maximum(length, 1e-9)[:, None]
    return ((across < 0.1) & slides[:, None]).ravel()


def turned_away(X: Array, part: Probe, view: View) -> NDArray[np.bool_]:
    """Points that face away from the camera once carried over and lie out of sight, shape (points,).

    That they are not seen there says nothing for or against the motion ``X`` (4, 4).
    """
    if view.p_camera is None or not part.oriented:
        return np.zeros(len(part.points), dtype=bool)
    p = part.points @ X[:3, :3].T + X[:3, 3]
    away = np.einsum("ni,ni->n", part.normals @ X[:3, :3].T, view.p_camera - p) < 0
    seen = view.look(p, part.sigma_m, 0.001).seen
    return part.normal_ok & away & ((seen == Seen.HIDDEN) | (seen == Seen.NO_RETURN) | (seen == Seen.OUT))


def behind_itself(X: Array, part: Probe, view: View, label: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Points that the part itself hides once carried over, or of which the view has no return, shape (points,).

    The part hides what faces away from the camera then, and what lies within a plate's thickness behind a surface that
    came with the part, unless it is that surface by its normal. That such points are not seen says nothing for or
    against the motion ``X`` (4, 4).
    """
    if view.p_camera is None or not part.oriented:
        return np.zeros(len(part.points), dtype=bool)
    p = part.points @ X[:3, :3].T + X[:3, 3]
    n = part.normals @ X[:3, :3].T
    found = view.look(p, part.sigma_m, 0.001)
    index = np.maximum(found.index, 0)
    no_return = (found.seen == Seen.NO_RETURN) | (found.seen == Seen.OUT)
    hidden = found.seen == Seen.HIDDEN
    away = part.normal_ok & (np.einsum("ni,ni->n", n, view.p_camera - p) < 0)
    depth = -np.einsum("ni,ni->n", p - view.points[index], view.normals[index])
    same = part.normal_ok & (np.einsum("ni,ni->n", n, view.normals[index]) > OTHER_FACE_COS)
    within = (label[index] == Change.MOVED) & view.normal_ok[index] & ~same
    within &= (depth > 0) & (depth < THICKEST_M)
    return no_return | (hidden & (away | within))


def score(motions: list[JointMotion], scene: Scene, before: Probe, after: Probe, extra_m: float) -> Array:
    """Mean cost per motion (0 = everything explained), shape (motions,); both directions share one mean."""
    if not motions:
        return np.zeros(0)
    X = np.stack([m.transform() for m in motions])
    X_back = np.linalg.inv(X)
    total = np.zeros(len(motions))
    count, small = len(before.points) + len(after.points), scene.small()
    for start in range(0, len(motions), 512):
        part = slice(start, start + 512)
        if len(before.points):
            cost = carry(X[part], before, scene.after, scene.changes.after, extra_m, small=small)
            cost += COST_THROUGH * _passes_through(X[part], cost, before, scene, extra_m)
            total[part] += _by_patch(cost, before)
        if len(after.points):
            cost = carry(X_back[part], after, scene.before, scene.changes.before, extra_m, small=small)
            total[part] += _by_patch(cost, after)
    return total / max(count, 1)


def _passes_through(X: Array, cost: Array, part: Probe, scene: Scene, extra_m: float) -> Array:
    """Which points of the first view (h, m) meet a surface of their own plane half-way and leave it again."""
    halfway = X.copy()
    halfway[:, :3, 3] *= 0.5
    slides = np.flatnonzero(np.abs(X[:, :3, :3] - np.eye(3)).max(axis=(1, 2)) < 1e-9)
    through = np.zeros(cost.shape)
    if len(slides):
        met = carry(halfway[slides], part, scene.after, scene.changes.after, extra_m) == COST_OVER_ITSELF
        through[slides] = met & (cost[slides] != COST_OVER_ITSELF)
    return through


def _by_patch(cost: Array, part: Probe) -> Array:
    """Summed cost per hypothesis where a patch costs no more than a foreign one."""
    size = part.patch.sum(axis=0)
    return np.minimum(cost @ part.patch, COST_FOREIGN * size).sum(axis=1)
