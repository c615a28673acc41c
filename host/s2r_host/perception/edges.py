"""Where things end in both views: outlines in colour of small parts, depth edges of all else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.change import Change
from s2r_host.perception.evidence import Scene
from s2r_host.perception.outline import outline
from s2r_host.perception.view import DepthView, View

Array = NDArray[np.floating]
Label = NDArray[np.uint8]
Mask = NDArray[np.bool_]

LEAST = 20  # fewer edge points than that tell nothing
OUTLINE_SOFT_M = 0.0015  # a pixel
EDGE_SOFT_M = 0.004  # edges of a stereo image are ragged by several pixels
OUTLINE_WEIGHT, EDGE_WEIGHT = 0.25, 0.5  # against points on surfaces
SAME_SIDE = 0.7  # cosine between outward directions of outlines that may belong together
STILL_M, STILL_WITHIN_M, STILL_SIDE = 0.0025, 0.02, 0.9  # across the outline, along it, cosine: it has stayed
NEIGHBOURS = 6


@dataclass(frozen=True, eq=False)
class Edges:
    """Points where something ends in a view.

    Attributes:
        points: In the base frame [m], (n, 3).
        across: Unit normals of the planes through camera and edge, (n, 3); outwards if ``sharp``, else of any sense.
        sharp: Outlines in colour; otherwise depth edges.
    """

    points: Array
    across: Array
    sharp: bool

    @property
    def soft_m(self) -> float:
        """From what distance on one is doubted [m]."""
        return OUTLINE_SOFT_M if self.sharp else EDGE_SOFT_M

    @property
    def weight(self) -> float:
        """What a point tells, against one on a surface."""
        return OUTLINE_WEIGHT if self.sharp else EDGE_WEIGHT

    def of(self, chosen: Mask | NDArray[np.int64]) -> Edges:
        """Some of them."""
        return Edges(self.points[chosen], self.across[chosen], self.sharp)

    def tree(self) -> cKDTree | None:
        """For :meth:`matched`; None where there are too few."""
        return cKDTree(self.points) if len(self.points) >= LEAST else None

    def matched(self, tree: cKDTree, p: Array, across: Array, reach_m: float) -> NDArray[np.int64]:
        """The edge point that belongs to each of some others, -1 where there is none.

        Args:
            tree: Of these.
            p: The others, carried to where they would be [m], (m, 3).
            across: Their normals there, (m, 3).
            reach_m: Largest distance.
        """
        ks = range(1, (NEIGHBOURS if self.sharp else 1) + 1)
        distance, index = tree.query(p, k=list(ks), distance_upper_bound=reach_m)
        fits = np.isfinite(distance)
        index = np.where(fits, index, 0)
        if self.sharp:
            fits &= np.einsum("nki,ni->nk", self.across[index], across) > SAME_SIDE
        nearest = np.argmax(fits, axis=1)
        return np.where(fits.any(axis=1), np.take_along_axis(index, nearest[:, None], axis=1)[:, 0], -1)

    def without(self, other: Edges) -> Edges:
        """Without the outlines that another view shows at the same place: those of things that stayed."""
        if not len(self.points) or not len(other.points):
            return self
        distance, index = cKDTree(other.points).query(
            self.points, k=NEIGHBOURS, distance_upper_bound=STILL_WITHIN_M
        )
        found = np.isfinite(distance)
        index = np.where(found, index, 0)
        off = np.einsum("nki,ni->nk", other.points[index] - self.points[:, None], self.across)
        side = np.einsum("nki,ni->nk", other.across[index], self.across)
        return self.of(~(found & (side > STILL_SIDE) & (np.abs(off) < STILL_M)).any(axis=1))


def edges_of(scene: Scene) -> tuple[Edges, Edges]:
    """Edges of what did not surely stay, in the first and in the second view.

    Outlines are taken where both views have colour (a depth edge lies elsewhere than the outline it stands for) and the
    part is small. A plate's outline is that of another of its edges once it has turned, and its faces tell more.
    """
    sides = (
        (scene.before, scene.changes.before, scene.candidate_before),
        (scene.after, scene.changes.after, scene.candidate_after),
    )
    if scene.small():
        before, after = (
            outlines_of(view, (label != Change.STATIC) & candidate) for view, label, candidate in sides
        )
        if before is not None and after is not None:
            return before.without(after), after.without(before)
    return _depth_edges(*sides[0]), _depth_edges(*sides[1])


def outlines_of(view: View, chosen: Mask) -> Edges | None:
    """Outlines in colour of some of a view's points (n,); None without colour."""
    if not isinstance(view, DepthView) or view.colour is None:
        return None
    wanted = np.zeros(view.shape[0] * view.shape[1], bool)
    wanted[view.flat[chosen]] = True
    found = outline(view.depth, view.colour, view.K, wanted.reshape(view.shape))
    across = np.cross(found.outward_C[:, [1, 0, 2]] * (-1.0, 1.0, 0.0), found.p_C)
    across *= np.sign(np.einsum("ni,ni->n", across, found.outward_C))[:, None]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    R = view.X_base_camera[:3, :3]
    return Edges(found.p_C @ R.T + view.X_base_camera[:3, 3], across @ R.T, sharp=True)


def _depth_edges(view: View, label: Label, candidate: Mask) -> Edges:
    """Straight pieces of occluding depth edges."""
    nothing = Edges(np.zeros((0, 3)), np.zeros((0, 3)), sharp=False)
    index = np.flatnonzero(view.edge & (label != Change.STATIC) & candidate)
    if len(index) < LEAST or view.p_camera is None:
        return nothing
    p = view.points[index]
    _, neighbour = cKDTree(p).query(p, k=min(9, len(p)))
    centred = p[neighbour] - p[neighbour].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    straight = values[:, 1] < 0.25 * values[:, 2]
    across = np.cross(vectors[:, :, 2], p - view.p_camera)
    length = np.linalg.norm(across, axis=1)
    keep = straight & (length > 1e-6)
    return Edges(p[keep], across[keep] / length[keep, None], sharp=False)
