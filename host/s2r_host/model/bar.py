"""A lever: a straight bar that stands out from its hub. Its sides matter, for they are what gets pushed.

Cameras show one or two sides of a bar, fattened at the edges by the matching window. The flat pieces that suit lids and
fronts make of it a broad thin plate with splinters around it; a prism along its line is nearer to what a fingertip
meets. What its cross-section is has its outline told already (:mod:`s2r_host.perception.lever_outline`); else its faces
and its outlines in both views say it (:mod:`s2r_host.model.section`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_host.model.pieces import Piece, box, hull
from s2r_host.model.points import Look, ObservedObject
from s2r_host.model.section import Section, SectionLook, fit_section
from s2r_host.perception.lever_shape import LeverShape
from s2r_host.perception.line import HUB_M, main_line
from s2r_host.perception.motion import line_distance

Array = NDArray[np.floating]

LEAST_LENGTH_M, MOST_WIDTH_M = 0.045, 0.055
LEAST_SLENDER = 1.5  # length beside the hub over width
FAT_M = 0.0025  # by which an outline is too wide on each side
TRIM = 2.0  # percent of the points beyond either side, which are stray
LEAST_ACROSS = 0.3  # sine between bar and axis: along the axis nothing is pushed
END_M, WITHIN_M = 0.005, 0.03  # points so far from its ends, and so near to its line, are of its sides
ALONG = 0.35  # cosine; outlines that face more along the bar are those of its ends
LEAST_SEEN, LEAST_EDGE = 20, 8  # points
LONGEST_HIDDEN_M, ROOT_STEP_M = 0.06, 0.004  # of a bar, between its hub and where it is seen to have moved
CORNERS = 12  # of the prism that stands for a rod
LEAST_POINTS = 150


def bar_pieces(
    seen: ObservedObject, p_axis: Array, axis: Array, outlined: LeverShape | None = None
) -> list[Piece] | None:
    """A prism for the bar and a block for its hub, or None where the part is no bar.

    Args:
        seen: The part, in the pose of the first view.
        p_axis, axis: A point on the hinge's axis [m] and its unit vector, (3,) each.
        outlined: The bar, where its outline in both views told it.
    """
    radius = line_distance(p_axis, axis, seen.part)
    hub = _hub(seen.part[radius <= HUB_M], p_axis, axis)
    if outlined is not None:
        return [_outlined_prism(outlined), *hub]
    if seen.p_camera is None:
        return None
    out = seen.part[radius > HUB_M]
    fit = main_line(out)
    if fit is None:
        return None
    centre, along, near = fit
    along = along if along @ (centre - p_axis) > 0.0 else -along
    way = np.cross(axis, along)
    if np.linalg.norm(way) < LEAST_ACROSS:
        return None
    way /= np.linalg.norm(way)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = np.column_stack([along, way, np.cross(along, way)]), centre
    low, high = np.percentile((out[near] - centre) @ along, [1.0, 99.0])
    length = float(high - low)
    looks = [_in_section(look, X, (low, high), p_axis, axis) for look in seen.looks]
    looks = [look for look in looks if look is not None]
    if length < LEAST_LENGTH_M or not looks:
        return None
    section = fit_section(looks)
    width = 2.0 * float(section.half.max())
    if _spread_m(looks) > MOST_WIDTH_M or length < LEAST_SLENDER * width:
        return None
    low = min(float(low), _root(seen, section, X, float(low), p_axis, axis))
    return [_prism(section, X, low, float(high)), *hub]


def _outlined_prism(lever: LeverShape) -> Piece:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = lever.frame, lever.p_middle
    section = Section(np.zeros(2), np.zeros(2), lever.half_m, lever.rod, cost=0.0)
    return _prism(section, X, lever.root_m, lever.end_m)


def _in_section(
    look: Look, X: Array, span: tuple[float, float], p_axis: Array, axis: Array
) -> SectionLook | None:
    """A look in the bar's frame X (4, 4), without its ends and its hub; None where it shows next to nothing."""

    def local(p: Array) -> Array:
        return (p - X[:3, 3]) @ X[:3, :3]

    def of_bar(p: Array) -> NDArray[np.bool_]:
        q = local(p)
        inside = (q[:, 0] > span[0] + END_M) & (q[:, 0] < span[1] - END_M)
        return (
            inside & (np.linalg.norm(q[:, 1:], axis=1) < WITHIN_M) & (line_distance(p_axis, axis, p) > HUB_M)
        )

    surface = local(look.p[of_bar(look.p)])
    if len(surface) < LEAST_SEEN:
        return None
    towards = local(look.p_camera[None])[0, 1:]
    towards /= np.linalg.norm(towards)
    aside = np.array([-towards[1], towards[0]])
    if look.outline is None:
        return SectionLook(surface, towards, _rims(surface, aside), sharp=False)
    keep = of_bar(look.outline.points)
    p, across = local(look.outline.points[keep]), look.outline.across[keep] @ X[:3, :3]
    sides = [(np.abs(across[:, 0]) < ALONG) & (sign * (across[:, 1:] @ aside) > 0.0) for sign in (1.0, -1.0)]
    edges = tuple((p[side], across[side]) for side in sides if side.sum() >= LEAST_EDGE)
    return SectionLook(surface, towards, edges, sharp=True)


def _rims(surface: Array, aside: Array) -> tuple[tuple[Array, Array], ...]:
    """Both edges of a look without colours: the ends of its depth, less what the matching window adds to them."""
    edges = []
    for normal in (aside, -aside):
        end = float(np.percentile(surface[:, 1:] @ normal, 100.0 - TRIM)) - FAT_M
        edges.append((np.r_[0.0, end * normal][None], np.r_[0.0, normal][None]))
    return tuple(edges)


def _root(seen: ObservedObject, section: Section, X: Array, low: float, p_axis: Array, axis: Array) -> float:
    """Where the bar begins, at or before ``low``: at its hub, unless a camera saw through the place in between.

    Near the axis a lever hardly leaves its place, so what is there is taken for a thing that stayed.
    """
    t = np.arange(low, low - LONGEST_HIDDEN_M, -ROOT_STEP_M)
    line = np.column_stack([t, section.centre + t[:, None] * section.slope])
    p = line @ X[:3, :3].T + X[:3, 3]
    stop = (line_distance(p_axis, axis, p) < HUB_M) | seen.empty["part"](p)
    if not stop.any() or seen.empty["part"](p[int(np.argmax(stop))][None])[0]:
        return low
    return float(t[int(np.argmax(stop))])


def _spread_m(looks: Sequence[SectionLook]) -> float:
    """How wide the widest look shows the bar [m]."""
    widths = []
    for look in looks:
        across = look.surface[:, 1:] @ np.array([-look.towards[1], look.towards[0]])
        widths.append(float(np.ptp(np.percentile(across, [TRIM, 100.0 - TRIM]))) - 2.0 * FAT_M)
    return max(widths)


def _prism(section: Section, X: Array, low: float, high: float) -> Piece:
    """The solid with that cross-section from one along-coordinate to another, frame X (4, 4)."""
    along = np.r_[1.0, section.slope] / np.linalg.norm(np.r_[1.0, section.slope])
    way = np.array([0.0, 1.0, 0.0]) - along[1] * along
    way /= np.linalg.norm(way)
    turned = np.column_stack([along, way, np.cross(along, way)])
    Y = X.copy()
    Y[:3, :3] = X[:3, :3] @ turned
    Y[:3, 3] += X[:3, :3] @ np.r_[0.0, section.centre]
    if not section.circle:
        return box("bar", "part", Y, np.r_[low, -section.half], np.r_[high, section.half])
    angle = 2.0 * np.pi * (np.arange(CORNERS) + 0.5) / CORNERS
    ring = section.half[0] / np.cos(np.pi / CORNERS) * np.column_stack([np.cos(angle), np.sin(angle)])
    corners = np.concatenate([np.column_stack([np.full(CORNERS, end), ring]) for end in (low, high)])
    return hull("bar", "part", corners @ Y[:3, :3].T + Y[:3, 3])


def _hub(p: Array, p_axis: Array, axis: Array) -> list[Piece]:
    """A square block about the axis as high as what was seen there; none if that is next to nothing."""
    if len(p) < LEAST_POINTS:
        return []
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = np.column_stack([x, np.cross(axis, x), axis]), p_axis
    local = (p - p_axis) @ X[:3, :3]
    low, high = np.percentile(local[:, 2], [TRIM, 100.0 - TRIM])
    half = float(np.clip(np.percentile(np.linalg.norm(local[:, :2], axis=1), 80.0), 0.008, HUB_M)) / np.sqrt(
        2.0
    )
    return [box("hub", "part", X, np.array([-half, -half, low]), np.array([half, half, high]))]
