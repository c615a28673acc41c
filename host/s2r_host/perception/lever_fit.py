"""A bar on its hinge fitted to several looks from one place: to its edges in colour and to the depth of its faces.

Edges of colour are sharp but nameless, depth is named but smeared. A solid ties them together: what it would show as
edges is matched to the nearest edges of each look, narrower round by round, and its faces may differ from the depth
readings by what the medians of those differ. Hinge, turns, place and size of the bar all give way, each as far as it is
known beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.colour_edges import ColourEdges, colour_edges
from s2r_host.perception.frames import project
from s2r_host.perception.lever_shape import LeverShape, OutlinePoints
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.refine import perturbed
from s2r_host.perception.view import DepthView

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

REACH_PX = 60  # about the lever, in which edges are looked for
SAME_SIDE = 0.85  # cosine between edges that may be the same one
HIDDEN_M = 0.02  # behind what the look shows: not seen
EDGE_PX = 1.0  # how exactly an edge is told, neighbours erring alike
FACE_M = 0.0015  # the same of the median depth of half a bar
LEAST_FACE, LEAST_HALF = 30, 10  # readings on it
LEAST_AHEAD_M = 0.05  # of the camera
LEAST_EDGES = 30
# What is known beforehand: the hinge across itself [m] and its tilt [rad]; the bar across itself [m], its slopes, its
# end and half widths [m], its roll [rad]. An upright hinge may tilt as well: the camera's own pose is off by tenths of
# a degree, and with a quarter of this freedom a tenth of the hinges is told 8 instead of 6 mm off.
HINGE_M, TILT_RAD = 0.006, np.radians(1.0)
SHIFT_M, SLOPE, END_M, WIDE_M, ROLL_RAD = 0.006, 0.15, 0.012, 0.004, 0.1
STEP = 1e-5
MOST_STEP = 2.0  # of what is known beforehand, in one round
# The cost of an edge that is not found, and of one that is drawn nowhere, in pixels².
JUDGED_PX, MISSED_PX2 = 3.0, 9.0
DRAWN_PX, BESIDE_PX = 3.5, 6.0
CHANGED_PX2 = 0.1  # of what gives way by as much as it was known beforehand
CLEAR_M = 0.012  # of the hub, which hides and uncovers other things
RIM_PX = 3.0  # inside of a rod's outline: further in its shading has edges, too


@dataclass(frozen=True, eq=False)
class Look:
    """A look at the lever.

    Attributes:
        view: Depth and colour.
        edges: Of colour, without those of what stays.
        faces: Depth readings surely on its faces [m], (n, 3); None where it is not known which those are.
    """

    view: DepthView
    edges: ColourEdges
    faces: Array | None

    def pixels(self, p: Array) -> tuple[Array, Array]:
        """Of points (n, 3): pixels (n, 2) and depths [m] (n,)."""
        return project(p, self.view.K, self.view.X_base_camera)


def looks_at(views: list[tuple[DepthView, Mask | None]], drawn: list[Array]) -> list[Look]:
    """Looks from one place, of which the first two show what stays.

    Args:
        views: With the lever's points in each, (n,), where they are known.
        drawn: More points about which it may be seen [m], (m, 3) for each view.
    """
    shape = views[0][0].shape
    around = np.zeros(shape, np.uint8)
    for (view, part), p in zip(views, drawn, strict=True):
        if part is not None:
            around.ravel()[view.flat[part]] = 1
        if len(p):
            uv, _ = project(p, view.K, view.X_base_camera)
            cv2.fillConvexPoly(around, cv2.convexHull(np.rint(uv).astype(np.int32)), 1)
    where = cv2.dilate(around, np.ones((2 * REACH_PX + 1,) * 2, np.uint8)) > 0
    edges = [colour_edges(view.colour, where) for view, _ in views if view.colour is not None]
    still = edges[0].of(edges[0].stayed(edges[1]))
    return [
        Look(view, one.without(still), None if part is None else view.points[part & ~view.edge])
        for (view, part), one in zip(views, edges, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Believed:
    """What a fit begins with, and its answer.

    Attributes:
        hinge: Its axis; ``delta`` is not used.
        turns: From the first look to each of the others [rad].
        turn_sigmas: How well those are known [rad].
        shape: The bar in the first look.
    """

    hinge: JointMotion
    turns: Array
    turn_sigmas: Array
    shape: LeverShape

    @property
    def sigma(self) -> Array:
        """Of all that gives way, in the order of :meth:`changed`."""
        shape = [SHIFT_M, SHIFT_M, SLOPE, SLOPE, END_M, WIDE_M, WIDE_M, ROLL_RAD]
        return np.r_[HINGE_M, HINGE_M, TILT_RAD, TILT_RAD, self.turn_sigmas, shape]

    def changed(self, x: Array) -> Believed:
        """With hinge (shift 2, tilt 2), turns and shape (8) changed."""
        hinge, turns = perturbed(self.hinge, np.r_[x[2:4], x[:2], 0.0]), 4 + len(self.turns)
        y = x[turns:]
        shape = self.shape.changed(y[:2], y[2:4], float(y[4]), y[5:7], float(y[7]))
        return replace(self, hinge=hinge, turns=self.turns + x[4:turns], shape=shape.from_hinge(hinge))

    def shapes(self) -> list[LeverShape]:
        """The bar in each look."""
        turned = [self.shape.carried(replace(self.hinge, delta=float(turn))) for turn in self.turns]
        return [self.shape, *turned]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit.

    Attributes:
        believed: What came out.
        covariance: Of all that gave way, in the order of :meth:`Believed.changed`.
        cost: Per point of its outline [px²]: how far edges lie from it, what it does not explain, and how far it is
            from what was known beforehand.
        found: Share of its outline that each look shows, (looks,).
    """

    believed: Believed
    covariance: Array
    cost: float
    found: Array


def fit(looks: list[Look], prior: Believed, start: Array, gates_px: Array) -> Fitted | None:
    """Gauss-Newton with Tukey's weights, matched anew and narrower in every round.

    Args:
        looks: At the lever.
        prior: What is known beforehand.
        start: Changes of it to begin with, in the order of :meth:`Believed.changed`.
        gates_px: Largest distance of edges taken for the same, round by round.

    Returns:
        None where too few edges are found.
    """
    sigma, x = prior.sigma, start
    information = np.diag(sigma**-2)
    for gate in gates_px:
        edges = _Matched.of(looks, prior.changed(x), gate)
        r, dz = edges.residuals(prior.changed(x)), _off_faces(looks, prior.changed(x))
        if len(r) < LEAST_EDGES or not np.isfinite(r).all():
            return None
        J, Jz = np.empty((len(r), len(x))), np.empty((len(dz), len(x)))
        for k, step in enumerate(STEP * np.eye(len(x))):
            there = prior.changed(x + step)
            J[:, k] = (edges.residuals(there) - r) / STEP
            Jz[:, k] = (_off_faces(looks, there) - dz) / STEP
        w = np.maximum(0.0, 1.0 - (r / gate) ** 2) ** 2 / EDGE_PX**2
        wz = 1.0 / FACE_M**2 / np.maximum(1.0, np.abs(dz) / (2.0 * FACE_M))
        information = (J.T * w) @ J + (Jz.T * wz) @ Jz + np.diag(sigma**-2)
        step = -np.linalg.solve(information, (J.T * w) @ r + (Jz.T * wz) @ dz + x / sigma**2)
        x = x + step * min(1.0, MOST_STEP / float(np.max(np.abs(step) / sigma)))
    return _judged(looks, prior, x, np.linalg.inv(information))


@dataclass(frozen=True, eq=False)
class _Matched:
    """Points of the bar's outline in each look, those next to them, and the edges of colour that they are taken for.

    Attributes:
        looks: At the lever.
        points: Per look: the outline's, their neighbours, indices of their edges.
        in_sight: How many of the outline's points each look should show.
    """

    looks: list[Look]
    points: list[tuple[OutlinePoints, OutlinePoints, NDArray[np.int64]]]
    in_sight: Array

    @staticmethod
    def of(looks: list[Look], believed: Believed, gate_px: float) -> _Matched:
        """The nearest edges at about the same angle."""
        points, in_sight = [], []
        for look, shape in zip(looks, believed.shapes(), strict=True):
            assert look.view.p_camera is not None
            one, other = shape.outline(look.view.p_camera)
            uv, across, z = _across(look, shape, one, other)
            ahead = z > LEAST_AHEAD_M  # a start may lead the fit astray, up to the camera
            uv, across = np.where(ahead[:, None], uv, -1.0), np.where(ahead[:, None], across, 0.0)
            h, w = look.view.shape
            u, v = np.rint(uv).astype(int).T
            inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
            seen = look.view.depth[v.clip(0, h - 1), u.clip(0, w - 1)]
            shown = ahead & inside & ~((seen > 0.0) & (seen < z - HIDDEN_M))
            index = np.where(shown, look.edges.nearest(uv, across, gate_px, SAME_SIDE), -1)
            use = index >= 0
            points.append((one.of(use), other.of(use), index[use]))
            in_sight.append(int(shown.sum()))
        return _Matched(looks, points, np.array(in_sight))

    @property
    def found(self) -> Array:
        """Share of what each look should show that it does, (looks,)."""
        return np.array([len(index) for _, _, index in self.points]) / np.maximum(1, self.in_sight)

    def residuals(self, believed: Believed) -> Array:
        """Distances across the outline [px] from it to the edges, all looks together, (n,)."""
        off = []
        for look, shape, (one, other, index) in zip(self.looks, believed.shapes(), self.points, strict=True):
            uv, across, _ = _across(look, shape, one, other)
            off.append(np.einsum("ni,ni->n", look.edges.uv[index] - uv, across))
        return np.concatenate(off)


def _across(
    look: Look, shape: LeverShape, one: OutlinePoints, other: OutlinePoints
) -> tuple[Array, Array, Array]:
    """Of outline points with neighbours: pixels (n, 2), unit vectors across the outline (n, 2), depths [m] (n,)."""
    uv, z = look.pixels(one.on(shape))
    way = look.pixels(other.on(shape))[0] - uv
    way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    return uv, way[:, ::-1] * (1.0, -1.0), z


def _off_faces(looks: list[Look], believed: Believed) -> Array:
    """Median of how far depth readings lie behind the bar, its inner and its outer half in each look [m], (m,)."""
    off = []
    for look, shape in zip(looks, believed.shapes(), strict=True):
        if look.faces is None or look.view.p_camera is None:
            continue
        behind, along, hit = shape.behind_m(look.view.p_camera, look.faces)
        if hit.sum() < LEAST_FACE:
            off += [0.0, 0.0]
            continue
        outer = along >= np.median(along[hit])
        for half in (hit & ~outer, hit & outer):
            off.append(float(np.median(behind[half])) if half.sum() > LEAST_HALF else 0.0)
    return np.array(off)


def _judged(looks: list[Look], prior: Believed, x: Array, covariance: Array) -> Fitted:
    """How well changes of what was known beforehand explain all that the looks show there."""
    believed = prior.changed(x)
    edges = _Matched.of(looks, believed, JUDGED_PX)
    r, total = edges.residuals(believed), int(edges.in_sight.sum())
    off = np.minimum(r**2, MISSED_PX2).sum() + MISSED_PX2 * (total - len(r))
    cost = (off + float((_off_faces(looks, believed) ** 2).sum()) / FACE_M**2) / max(1, total)
    cost += MISSED_PX2 * _unexplained(looks, believed) + CHANGED_PX2 * float(((x / prior.sigma) ** 2).sum())
    return Fitted(believed, covariance, float(cost), edges.found)


def _unexplained(looks: list[Look], believed: Believed) -> float:
    """Edges of colour on the bar that it does not have, per point of its outline; 1 where none could be judged."""
    shares = []
    for look, shape in zip(looks, believed.shapes(), strict=True):
        assert look.view.p_camera is not None
        drawn = shape.outline(look.view.p_camera)[0]
        uv = look.pixels(drawn.of(drawn.at_end | (drawn.at[:, 0] > shape.root_m + CLEAR_M)).on(shape))[0]
        near = (
            (look.edges.uv > uv.min(axis=0) - BESIDE_PX) & (look.edges.uv < uv.max(axis=0) + BESIDE_PX)
        ).all(axis=1)
        hull = cv2.convexHull(uv.astype(np.float32))
        if len(hull) < 3 or not near.any():
            continue
        there = look.edges.uv[near]
        inside_px = np.array([cv2.pointPolygonTest(hull, (float(u), float(v)), True) for u, v in there])
        own = there[(inside_px > -BESIDE_PX) & (inside_px < (RIM_PX if shape.rod else np.inf))]
        if len(own):
            shares.append(float((cKDTree(uv).query(own)[0] > DRAWN_PX).sum()) / max(1, len(uv)))
    return float(np.mean(shares)) if shares else 1.0
