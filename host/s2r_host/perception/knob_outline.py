"""The outline of a knob with spokes from above, and how far it has turned, by its colours.

Stereo depth shows a knob of 6 cm as a blob: the windows that it compares are as wide as a spoke. In colour its top
stands out from what is below it. The image, laid onto the plane of the top, is explained by a round hub with equal
spokes; where the sides of the knob may be seen, that is from each point of the outline towards the camera, colours say
little and count little. Flat tops only: light falls on rods from all sides, and what has no one colour is not told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.optimize import least_squares

from s2r_host.perception.frames import DepthFrame, backproject, project

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

CELL_M, HALF_M = 0.001, 0.075  # of the picture from above
COARSE = 2  # cells
SMOOTH_CELLS = 1.0
TOP_M = 0.010  # about the middle, where the hub's top is seen
LEAST_TOP = 25  # depth readings there
BELOW_M = 0.02  # height of a side that may be seen; further down it is in the shade of what is above
BESIDE_M = 0.006  # beyond the tips: what is there is not the knob's
# It is seen from so far above what it stands on, to so far above its top.
ABOVE_FOOT_M, ABOVE_TOP_M = 0.004, 0.008
# What it stands on is seen in a ring beside it, lower than its top, most of it within a few millimetres.
RING_M, LEAST_HEIGHT_M, LEVEL_M, LEAST_RING = (0.008, 0.035), 0.006, 0.002, 100
COLOURS = 8  # of what is around it
CONTRAST = 6.0  # 8-bit levels over which a colour goes from the knob's to another
EDGE_M = 0.0007  # over which the outline is drawn
SIDES_COUNT = 0.25  # weight of colours where sides may be seen
HUB_M, BEYOND_M, WIDTH_M = (0.008, 0.035), (0.004, 0.045), (0.006, 0.036)
SPOKES = (2, 3, 4, 5)
SHIFT_M = 0.012  # of the middle from where depth has it
STARTS, ROUNDS = 4, 3
BULGE_M = 0.0015  # of the hub beside two spokes; a straight lever, taken for a bar on a hub, has less
LEAST_EXPLAINED, LEAST_AGAIN = 0.82, 0.75  # of the outline's area, when first seen and in another look
# Of its reach, from which on what lies between the spokes is as good as filled: the round top of a column.
DISC = 0.87
TURN_STEP_RAD, TURN_SHIFT_M = np.deg2rad(2.0), 0.004


@dataclass(frozen=True, eq=False)
class KnobOutline:
    """A round hub with equal spokes, seen along its upright axis; base frame.

    Attributes:
        p_axis: The point of its axis at the height of its top [m], (3,).
        hub_m: Radius of its hub [m].
        reach_m: From the axis to the tips of the spokes [m].
        width_m: Of a spoke [m].
        spokes: How many.
        angle: Of one of them, counter-clockwise from x [rad].
        foot_m: Height of what it stands on [m].
        explained: 1 less the share of its area that colours contradict.
    """

    p_axis: Array
    hub_m: float
    reach_m: float
    width_m: float
    spokes: int
    angle: float
    foot_m: float
    explained: float = 0.0

    @property
    def bulges(self) -> bool:
        """Whether the hub stands out beside a spoke: what is straight has none to show, whatever it turns about."""
        return self.hub_m - 0.5 * self.width_m > BULGE_M

    @property
    def valley_m(self) -> float:
        """How far it reaches midway between two spokes [m]: of a disc nearly as far as along them."""
        half = 0.5 * self.pitch
        return max(self.hub_m, min(0.5 * self.width_m / float(np.sin(half)), self.reach_m))

    @property
    def pitch(self) -> float:
        """From one spoke to the next [rad]."""
        return 2.0 * np.pi / self.spokes

    def angles(self) -> Array:
        """Of all spokes [rad], (spokes,)."""
        return np.asarray(self.angle + self.pitch * np.arange(self.spokes))

    def inside_m(self, xy: Array) -> Array:
        """How far points (..., 2) lie inside of it, negative outside [m], (...)."""
        at = xy - self.p_axis[:2]
        depth = self.hub_m - np.sqrt(
            at[..., 0] ** 2 + at[..., 1] ** 2
        )  # norm takes four times as long for pairs
        for angle in self.angles():
            out, aside = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
            along, across = at @ out, np.abs(at @ aside)
            spoke = np.minimum(0.5 * self.width_m - across, np.minimum(self.reach_m - along, along))
            depth = np.maximum(depth, spoke)
        return np.asarray(depth)

    def covers(self, p: Array) -> Mask:
        """Which of points (n, 3) are its own, as depth smears them, whatever way it is turned, (n,)."""
        away = np.linalg.norm(p[:, :2] - self.p_axis[:2], axis=1)
        low, high = self.foot_m + ABOVE_FOOT_M, float(self.p_axis[2]) + ABOVE_TOP_M
        return np.asarray((away < self.reach_m + BESIDE_M) & (p[:, 2] > low) & (p[:, 2] < high))


def fit_outline(
    frame: DepthFrame, p_middle: Array, reach_m: float, foot_m: float, spokes: Sequence[int] = SPOKES
) -> KnobOutline | None:
    """The outline of a knob.

    Args:
        frame: Depth and colour.
        p_middle: About the middle of its top [m], (3,).
        reach_m: About how far it reaches from there [m].
        foot_m: Height of what it stands on [m].
        spokes: How many it may have.

    Returns:
        None where there is no colour, no depth on its top, or no outline with spokes that explains the colours.
    """
    p_top = _top(frame, p_middle)
    if p_top is None or frame.colour is None:
        return None
    seen = _Seen.of(frame, p_top, reach_m)
    coarse = seen.coarse()
    rough = [_fitted(coarse, start) for start in _starts(coarse, p_top, reach_m, foot_m, spokes)[:STARTS]]
    best = _fitted(seen, max(rough, key=lambda one: one.explained))
    told = best.explained > LEAST_EXPLAINED and best.valley_m < DISC * best.reach_m
    return best if told else None


def on_its_foot(outline: KnobOutline, p: Array) -> KnobOutline:
    """The same knob on what most points (n, 3) beside it lie on; as it is where the view shows little of that."""
    away = np.linalg.norm(p[:, :2] - outline.p_axis[:2], axis=1) - outline.reach_m
    z = p[(away > RING_M[0]) & (away < RING_M[1]) & (p[:, 2] < outline.p_axis[2] - LEAST_HEIGHT_M), 2]
    if len(z) < LEAST_RING:
        return outline
    level = np.round(z / LEVEL_M).astype(int)
    usual = np.argmax(np.bincount(level - level.min())) + level.min()
    return replace(outline, foot_m=float(np.median(z[np.abs(level - usual) <= 1])))


def turned_outline(outline: KnobOutline, frame: DepthFrame, expected: float = 0.0) -> KnobOutline | None:
    """The same knob in another look from any place, turned.

    Args:
        outline: In an earlier look.
        frame: The new one.
        expected: About how far it has turned [rad]: to half the spacing of the spokes, which are alike.

    Returns:
        With ``angle`` changed by the turn; None where no turn explains the colours.
    """
    if frame.colour is None:
        return None
    seen = _Seen.of(frame, outline.p_axis, outline.reach_m)
    turns = np.arange(-0.5 * outline.pitch, 0.5 * outline.pitch + 1e-9, TURN_STEP_RAD)
    coarse = seen.coarse()
    starts = [replace(outline, angle=outline.angle + expected + turn) for turn in turns]
    start = min(starts, key=lambda one: coarse.cost(one))
    x0 = np.array([0.0, 0.0, start.angle])

    def at(x: Array) -> KnobOutline:
        shift = np.append(TURN_SHIFT_M * x[:2], 0.0)
        return replace(outline, p_axis=outline.p_axis + shift, angle=float(x[2]))

    for _ in range(ROUNDS):
        weight = seen.weight(at(x0))
        found = least_squares(
            lambda x, weight=weight: np.concatenate([seen.residuals(at(x), weight), x[:2]]),
            x0, diff_step=1e-3, max_nfev=30,
        )  # fmt: skip
        x0 = found.x
    turned = at(x0)
    turned = replace(turned, explained=seen.explained(turned))
    return turned if turned.explained > LEAST_AGAIN else None


@dataclass(frozen=True, eq=False)
class _Seen:
    """A look laid onto the plane of a knob's top.

    Attributes:
        xy: Places of its cells [m], (n, 2).
        own: How far each has the knob's colour rather than one of those around it, 0 to 1, (n,).
        to_camera: How far a point shifts in the picture per metre that it lies below the plane, (2,).
        few: Cells that are enough for a first guess, (n,).
    """

    xy: Array
    own: Array
    to_camera: Array
    few: Mask

    @staticmethod
    def of(frame: DepthFrame, p_top: Array, reach_m: float) -> _Seen:
        """The look, about a point (3,) of a knob's top that reaches so far."""
        cells = round(2.0 * HALF_M / CELL_M)
        grid = (np.arange(cells) + 0.5) * CELL_M - HALF_M
        xy = np.stack(np.meshgrid(grid, grid), axis=-1) + p_top[:2]
        p = np.concatenate([xy, np.full((*xy.shape[:2], 1), p_top[2])], axis=-1)
        uv, _ = project(p, frame.K, frame.X_base_camera)
        assert frame.colour is not None
        colour = cv2.remap(
            frame.colour.astype(np.float32),
            uv[..., 0].astype(np.float32),
            uv[..., 1].astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        colour = cv2.GaussianBlur(colour, (0, 0), SMOOTH_CELLS)
        away = np.linalg.norm(xy - p_top[:2], axis=-1)
        eye = frame.X_base_camera[:3, 3] - p_top
        own = _own(np.asarray(colour, float), away < TOP_M, away > reach_m + BESIDE_M)
        keep = away < reach_m + BESIDE_M + SHIFT_M
        few = np.zeros_like(keep)
        few[::COARSE, ::COARSE] = True
        return _Seen(xy[keep], own[keep], eye[:2] / max(float(eye[2]), 0.1), few[keep])

    def coarse(self) -> _Seen:
        """Every so many cells."""
        return _Seen(self.xy[self.few], self.own[self.few], self.to_camera, self.few[self.few])

    def weight(self, outline: KnobOutline) -> Array:
        """How much each cell counts: less where a side of the knob may be seen, or where nothing is the knob's."""
        below = np.linspace(0.0, BELOW_M, 6)[1:]
        inside = outline.inside_m(self.xy) > 0.0
        sides = np.zeros_like(inside)
        for depth in below:
            sides |= outline.inside_m(self.xy - depth * self.to_camera) > 0.0
        near = np.linalg.norm(self.xy - outline.p_axis[:2], axis=-1) < outline.reach_m + BESIDE_M
        return np.where(sides & ~inside, SIDES_COUNT, 1.0) * near

    def residuals(self, outline: KnobOutline, weight: Array) -> Array:
        """Of all cells, (n,)."""
        drawn = 1.0 / (1.0 + np.exp(-np.clip(outline.inside_m(self.xy) / EDGE_M, -30.0, 30.0)))
        return np.asarray((weight * (drawn - self.own)).ravel())

    def cost(self, outline: KnobOutline) -> float:
        """Share of the outline's area that is contradicted."""
        off = np.abs(self.residuals(outline, self.weight(outline))).sum()
        return float(off / max(1, int((outline.inside_m(self.xy) > 0.0).sum())))

    def rough_cost(self, outline: KnobOutline) -> float:
        """The same, sides left out of account."""
        inside = outline.inside_m(self.xy) > 0.0
        return float(np.abs(inside - self.own).sum() / max(1, int(inside.sum())))

    def explained(self, outline: KnobOutline) -> float:
        """As in :class:`KnobOutline`."""
        return 1.0 - self.cost(outline)


def _own(colour: Array, top: Mask, around: Mask) -> Array:
    """How far each cell has the colour of the top rather than one of those around, 0 to 1."""
    mine = np.median(colour[top], axis=0)
    others = kmeans2(colour[around][::7].astype(float), COLOURS, minit="++", rng=0)[0]
    others = others[np.linalg.norm(others - mine, axis=1) > 2.0 * CONTRAST]
    if not len(others):
        return np.full(colour.shape[:2], 0.5)
    to_mine = np.linalg.norm(colour - mine, axis=-1)
    to_other = np.min([np.linalg.norm(colour - one, axis=-1) for one in others], axis=0)
    return np.asarray(1.0 / (1.0 + np.exp(np.clip((to_mine - to_other) / CONTRAST, -30.0, 30.0))))


def _starts(
    coarse: _Seen, p: Array, reach_m: float, foot_m: float, spokes: Sequence[int]
) -> list[KnobOutline]:
    """Outlines about a point of a knob, the best first, one of each number of spokes and size of hub and spoke."""
    found = []
    shifts = np.linspace(-0.5 * SHIFT_M, 0.5 * SHIFT_M, 3)
    for count, hub, width in product(spokes, (0.4, 0.6), (0.012, 0.02, 0.03)):
        pitch, size = 2.0 * np.pi / count, (hub * reach_m, reach_m, width, count)
        turned = [
            KnobOutline(p + np.array([dx, dy, 0.0]), *size, pitch * k / 8.0, foot_m)
            for k, dx, dy in product(range(8), shifts, shifts)
        ]
        costs = [coarse.rough_cost(one) for one in turned]
        found.append((min(costs), turned[int(np.argmin(costs))]))
    return [one for _, one in sorted(found, key=lambda pair: pair[0])]


def _fitted(seen: _Seen, start: KnobOutline) -> KnobOutline:
    """The outline near another that explains the colours best."""

    def at(x: Array) -> KnobOutline:
        p = start.p_axis + np.append(0.01 * x[:2], 0.0)
        hub, beyond, width = 0.01 * x[2:5]
        return replace(
            start,
            p_axis=p,
            hub_m=float(hub),
            reach_m=float(hub + beyond),
            width_m=float(width),
            angle=float(x[5]),
        )

    sizes = np.array([start.hub_m, start.reach_m - start.hub_m, start.width_m])
    (least, most), shift = np.transpose([HUB_M, BEYOND_M, WIDTH_M]), np.full(2, SHIFT_M)
    low = np.append(100.0 * np.concatenate([-shift, least]), start.angle - 1.0)
    high = np.append(100.0 * np.concatenate([shift, most]), start.angle + 1.0)
    x = np.append(100.0 * np.concatenate([np.zeros(2), sizes]), start.angle)
    x = np.clip(x, low + 1e-3, high - 1e-3)
    for _ in range(ROUNDS):
        weight = seen.weight(at(x))
        found = least_squares(
            lambda x, weight=weight: seen.residuals(at(x), weight),
            x,
            bounds=(low, high),
            diff_step=1e-3,
            max_nfev=15,
        )
        x = np.clip(found.x, low + 1e-3, high - 1e-3)
    fitted = at(x)
    return replace(fitted, explained=seen.explained(fitted))


def _top(frame: DepthFrame, p_middle: Array) -> Array | None:
    """The middle of a knob's top at the height that depth has about it, (3,)."""
    h, w = frame.depth_m.shape
    (u, v), _ = project(p_middle, frame.K, frame.X_base_camera)
    r = frame.K[0, 0] * TOP_M / max(float(np.linalg.norm(frame.X_base_camera[:3, 3] - p_middle)), 0.05)
    vs, us = np.mgrid[0:h, 0:w]
    near = ((us - u) ** 2 + (vs - v) ** 2 < r * r) & (frame.depth_m > 0.0)
    if near.sum() < LEAST_TOP:
        return None
    p_seen = backproject(frame.depth_m, frame.K, frame.X_base_camera)[near]
    return np.append(p_middle[:2], float(np.median(p_seen[:, 2])))
