"""How far a lever has turned between two looks, by its edges in colour.

A stereo matcher compares windows: what is as thin as a lever comes out rounded, fattened towards one side, and nearer
to what is behind it than it is. All of that changes as the lever turns, so that its depth tells the turn to 3 degrees
rather than to its noise. Colour is sharp. Edges in colour of the first look are given the depth they have there,
carried by the turn, and compared across themselves with the nearest edges of the second look; as the depth is wrong,
and where the hinge is is known to some millimetres only, both may give way.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.colour_edges import colour_edges
from s2r_host.perception.frames import project
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.refine import perturbed
from s2r_host.perception.view import DepthView

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

BESIDE_PX = 3  # depth ends short of the outline, or beyond it
REACH_PX = 60  # about the part, in which it is looked for
SAME_SIDE = 0.85  # cosine between edges that may be the same one
GATES_PX = np.geomspace(8.0, 2.5, 10)  # largest distance of edges taken for the same, round by round
HIDDEN_M = 0.02  # behind what the second look shows: not seen
# How exactly edges are told, and how many neighbours err alike; what is known beforehand of the hinge's place [m], of
# the depth of the edges [m], and of the turn [rad].
EDGE_PX, CORRELATED = 0.7, 4.0
HINGE_M, DEPTH_M, TURN_RAD = 0.004, 0.003, 0.1
LEAST_EDGES, LEAST_SHARE = 15, 0.4  # found again; fewer tell nothing


@dataclass(frozen=True)
class Turn:
    """A turn [rad] and its standard error."""

    delta: float
    sigma: float


def turn_by_colour(before: DepthView, part: Mask, after: DepthView, motion: JointMotion) -> Turn | None:
    """The turn of a part between two views.

    Args:
        before: First view.
        part: Its points that are the part's, (n,).
        after: Second view.
        motion: The hinge, and about how far the part turned: within some degrees.

    Returns:
        None without colour, or where too few edges are found again.
    """
    if before.colour is None or after.colour is None or not part.any():
        return None
    search = _Search(before, part, after)
    free = np.zeros(4)  # hinge across itself twice [m], turn [rad], depth [m], as changes
    known = 1.0 / np.array([HINGE_M, HINGE_M, TURN_RAD, DEPTH_M]) ** 2
    information, found = np.diag(known), 0
    for gate in GATES_PX:
        match = search.matched(_changed(motion, free), free[3], gate)
        r = search.residuals(_changed(motion, free), free[3], match)
        found = len(r)
        if found < LEAST_EDGES:
            return None
        J = np.empty((len(r), 4))
        for k, step in enumerate(1e-5 * np.eye(4)):
            there = free + step
            J[:, k] = (search.residuals(_changed(motion, there), there[3], match) - r) / 1e-5
        weight = np.maximum(0.0, 1.0 - (r / gate) ** 2) ** 2 / (EDGE_PX**2 * CORRELATED)
        information = (J.T * weight) @ J + np.diag(known)
        free = free - np.linalg.solve(information, (J.T * weight) @ r + known * free)
    if found < LEAST_SHARE * len(search.edges.uv):
        return None
    return Turn(motion.delta + float(free[2]), float(np.sqrt(np.linalg.inv(information)[2, 2])))


def _changed(motion: JointMotion, free: Array) -> JointMotion:
    return perturbed(motion, np.array([0.0, 0.0, free[0], free[1], free[2]]))


class _Search:
    """The part's edges of one view, to be found in another."""

    def __init__(self, before: DepthView, part: Mask, after: DepthView) -> None:
        self._before, self._after = before, after
        shown = np.zeros(before.shape[0] * before.shape[1], np.uint8)
        shown[before.flat[part]] = 1
        shown = shown.reshape(before.shape)
        beside, around = (
            cv2.dilate(shown, np.ones((2 * reach + 1,) * 2, np.uint8)) > 0 for reach in (BESIDE_PX, REACH_PX)
        )
        # Of an edge between the part and what is behind it, the part's depth.
        near = np.where(shown > 0, before.depth, np.inf).astype(np.float32)
        near = cv2.erode(near, np.ones((2 * BESIDE_PX + 1,) * 2, np.uint8), borderValue=float("inf"))
        assert before.colour is not None
        assert after.colour is not None
        all_before, all_after = colour_edges(before.colour, around), colour_edges(after.colour, around)
        edges = all_before.without(all_after)
        u, v = np.rint(edges.uv).astype(int).T
        own = beside[v, u] & np.isfinite(near[v, u])
        self.edges, self._z = edges.of(own), near[v, u][own].astype(float)
        self._targets = all_after.without(all_before)

    def matched(self, motion: JointMotion, deeper_m: float, gate_px: float) -> NDArray[np.int64]:
        """For every edge the one of the second view that it is taken for, or -1."""
        uv, across, z = self._carried(motion, deeper_m)
        found = self._targets.nearest(uv, across, gate_px, SAME_SIDE)
        h, w = self._after.shape
        u, v = np.rint(np.nan_to_num(uv, nan=-1.0)).astype(int).T
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        seen = self._after.depth[v.clip(0, h - 1), u.clip(0, w - 1)]
        hidden = (seen > 0.0) & (seen < z - HIDDEN_M)
        return np.where(inside & ~hidden, found, -1)

    def residuals(self, motion: JointMotion, deeper_m: float, match: NDArray[np.int64]) -> Array:
        """Distances across the edges [px] from those carried to those they are taken for."""
        uv, across, _ = self._carried(motion, deeper_m)
        use = match >= 0
        return np.einsum("ni,ni->n", self._targets.uv[match[use]] - uv[use], across[use])

    def _carried(self, motion: JointMotion, deeper_m: float) -> tuple[Array, Array, Array]:
        """The edges as the second view would have them: place, unit vectors across, depth [m]."""
        along = self.edges.across[:, ::-1] * (-1.0, 1.0)
        one, other = (
            self._seen_after(self.edges.uv + side * along, motion, deeper_m) for side in (-1.0, 1.0)
        )
        way = other[:, :2] - one[:, :2]
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        middle = 0.5 * (one + other)
        return middle[:, :2], way[:, ::-1] * (1.0, -1.0), middle[:, 2]

    def _seen_after(self, uv: Array, motion: JointMotion, deeper_m: float) -> Array:
        """Pixels of the first view at the edges' depth, carried: u, v and depth [m] in the second, (n, 3)."""
        K, X = self._before.K, self._before.X_base_camera
        z = self._z + deeper_m
        p_C = np.column_stack([(uv - K[:2, 2]) / K[[0, 1], [0, 1]] * z[:, None], z])
        p = p_C @ X[:3, :3].T + X[:3, 3]
        T = motion.transform()
        p = p @ T[:3, :3].T + T[:3, 3]
        return np.column_stack(project(p, self._after.K, self._after.X_base_camera))


def combined(depth: Turn, colour: Turn) -> Turn:
    """What two ways that err differently tell together."""
    one, other = 1.0 / depth.sigma**2, 1.0 / colour.sigma**2
    return Turn((one * depth.delta + other * colour.delta) / (one + other), (one + other) ** -0.5)
