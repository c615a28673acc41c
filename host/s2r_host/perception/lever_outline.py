"""A lever told by the outline of a solid: its size, its hinge, and how far it turned between looks.

Depth alone has a lever's turn between two looks to a degree or two and its hinge to some millimetres; where it points
at the camera, worse. A bar or a rod on a hinge that has its edges where colour has edges in both looks tells all of
that sharper, and its own cross-section.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.colour_change import comparable
from s2r_host.perception.colour_turn import Turn, combined, turn_by_colour
from s2r_host.perception.lever_fit import Believed, Fitted, fit, looks_at
from s2r_host.perception.lever_shape import LeverShape
from s2r_host.perception.line import HUB_M, main_line
from s2r_host.perception.motion import JointMotion, line_distance, unit
from s2r_host.perception.view import DepthView

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

LEAST_ACROSS = 0.3  # sine between bar and axis
FAT_M, USUAL_HALF_M = 0.002, 0.010  # a side's depth is wider by so much; half of what levers measure across
NEAR_SIDE_M = 0.004  # from the readings to the middle line, away from the camera
DEPTH_TURN_RAD, COLOUR_TURN_RAD, UNTOLD_RAD = np.radians(1.2), np.radians(0.5), np.radians(2.0)
GATES_PX, GATES_AGAIN_PX = np.geomspace(10.0, 2.5, 9), np.geomspace(8.0, 2.5, 8)
START_TURNS_RAD, START_SLOPES, START_WIDER_M = (
    np.radians([-2.0, 0.0, 2.0]),
    (-0.2, 0.0, 0.2),
    (0.0, 0.003, 0.006),
)
MOST_COST = 3.5  # px²; what costs more is told no better than by depth
ERRORS_SHARED = 1.3  # edges err alike, and the solid is none of its kind: errors are larger than they seem
AGAIN_RAD, LEAST_FOUND = np.radians(1.5), 0.6
# A turn is as sure as edges make it up to so many px², and errs by so much for each more.
SURE_COST, ASTRAY_RAD = 2.0, np.radians(0.5)


@dataclass(frozen=True, eq=False)
class LeverOutline:
    """A lever as its outline tells it.

    Attributes:
        hinge: Its axis, and the turn from the first look to the second.
        turn_sigma: Of that turn [rad].
        shape: The bar in the first look.
    """

    hinge: JointMotion
    turn_sigma: float
    shape: LeverShape


def lever_outline(
    before: DepthView, part_before: Mask, after: DepthView, part_after: Mask, motion: JointMotion
) -> LeverOutline | None:
    """The lever that two looks from one place show.

    Args:
        before, after: The looks.
        part_before, part_after: Their points that are the lever's, (n,) each.
        motion: Its hinge and turn, as depth tells them.

    Returns:
        None without colour, where the camera moved, or where no bar explains the looks.
    """
    start = _seen_bar(before, part_before, after, part_after, motion)
    if start is None or not comparable(before, after):
        return None
    turn = _turn(before, part_before, after, motion)
    looks = looks_at([(before, part_before), (after, part_after)], [np.empty((0, 3))] * 2)
    found = []
    for rod in (False, True):
        shape = replace(start, rod=rod, half_m=np.full(2, start.half_m[0]) if rod else start.half_m)
        prior = Believed(motion, np.array([turn.delta]), np.array([turn.sigma]), shape.from_hinge(motion))
        for x in _starts(len(prior.sigma), rod):
            fitted = fit(looks, prior, x, GATES_PX)
            if fitted is not None and not fitted.believed.shape.thinnest:
                found.append(fitted)
    best = min(found, key=lambda one: one.cost, default=None)
    return None if best is None or best.cost > MOST_COST else _told(best)


@dataclass(frozen=True)
class Turns:
    """How far a lever has turned in a third look.

    Attributes:
        since_first, since_second: Since each of the two looks that told it; the worse the solid explains the looks, the
            vaguer.
        found: Share of its outline that the third look shows.
        explained: The solid explains all three as well as is asked of one that tells a joint.
    """

    since_first: Turn
    since_second: Turn
    found: float
    explained: bool


def turns_since(
    told: LeverOutline, looks: Sequence[tuple[DepthView, Mask]], now: DepthView, expected: float
) -> Turns | None:
    """How far a lever has turned in a third look.

    Args:
        told: The lever as those two tell it.
        looks: These two, with their points that are the lever's, (n,) each.
        now: The third, from the same place.
        expected: About how far it has turned since the first [rad].

    Returns:
        None where its outline is not found there.
    """
    (before, part_before), (after, part_after) = looks
    if not (comparable(before, after) and comparable(before, now)):
        return None
    turns, sigmas = np.array([told.hinge.delta, expected]), np.array([told.turn_sigma, AGAIN_RAD])
    believed = Believed(told.hinge, turns, sigmas, told.shape)
    drawn = [np.empty((0, 3)), np.empty((0, 3)), _corners(believed.shapes()[2])]
    seen = looks_at([(before, part_before), (after, part_after), (now, None)], drawn)
    # A third look may show an edge that the two before did not, and so that a rod is a box.
    kinds = (replace(believed, shape=shape) for shape in (told.shape, _other_kind(told.shape)))
    fits = (fit(seen, kind, np.zeros(len(kind.sigma)), GATES_AGAIN_PX) for kind in kinds)
    found = [one for one in fits if one is not None and one.found[2] >= LEAST_FOUND]
    best = min(found, key=lambda one: one.cost, default=None)
    if best is None:
        return None
    first, again = best.believed.turns
    C = ERRORS_SHARED**2 * best.covariance[4:6, 4:6]
    astray = ASTRAY_RAD * max(0.0, best.cost - SURE_COST)
    since_first, between = (
        float(np.hypot(np.sqrt(max(variance, 0.0)), astray))
        for variance in (C[1, 1], C[0, 0] + C[1, 1] - 2.0 * C[0, 1])
    )
    return Turns(
        Turn(float(again), since_first),
        Turn(float(again - first), between),
        float(best.found[2]),
        explained=best.cost <= MOST_COST,
    )


def _other_kind(shape: LeverShape) -> LeverShape:
    """The box about as wide as a rod, or the rod as wide as a box."""
    return replace(shape, rod=not shape.rod, half_m=np.full(2, shape.half_m[0]))


def _seen_bar(
    before: DepthView, part_before: Mask, after: DepthView, part_after: Mask, motion: JointMotion
) -> LeverShape | None:
    """The bar about the line that depth has, in the first look; None where the part is no bar."""
    X = np.linalg.inv(motion.transform())
    p = np.concatenate(
        [
            before.points[part_before & ~before.edge],
            after.points[part_after & ~after.edge] @ X[:3, :3].T + X[:3, 3],
        ]
    )
    out = p[line_distance(motion.origin, motion.direction, p) > HUB_M]
    line = main_line(out)
    if line is None or before.p_camera is None:
        return None
    centre, along, near = line
    along = along if along @ (centre - motion.origin) > 0.0 else -along
    way = np.cross(motion.direction, along)
    if np.linalg.norm(way) < LEAST_ACROSS:
        return None
    frame = np.column_stack([along, unit(way), np.cross(along, unit(way))])
    local = (out[near] - centre) @ frame
    wide = np.ptp(np.percentile(local[:, 1:], [5.0, 95.0], axis=0), axis=0)
    half = 0.5 * (0.5 * wide - FAT_M + USUAL_HALF_M)
    sight = centre - before.p_camera
    centre = centre + NEAR_SIDE_M * unit(sight - (sight @ along) * along)
    end_m = float(np.percentile(local[:, 0], 99.5))
    return LeverShape(centre, frame, 0.0, end_m, half, rod=False)


def _turn(before: DepthView, part: Mask, after: DepthView, motion: JointMotion) -> Turn:
    """The turn as depth and edges in colour without a solid tell it; the further those differ, the vaguer."""
    colour = turn_by_colour(before, part, after, motion)
    if colour is None:
        return Turn(motion.delta, UNTOLD_RAD)
    colour = replace(colour, sigma=float(np.hypot(colour.sigma, COLOUR_TURN_RAD)))
    both = combined(Turn(motion.delta, DEPTH_TURN_RAD), colour)
    return replace(both, sigma=float(np.hypot(both.sigma, 0.5 * (colour.delta - motion.delta))))


def _starts(count: int, rod: bool) -> list[Array]:
    """Changes of what is believed to begin with: the turn with the slope out of the plane, or with a rod's width."""
    starts = []
    for turn, other in product(START_TURNS_RAD, START_WIDER_M if rod else START_SLOPES):
        x = np.zeros(count)
        x[4], x[-3 if rod else -5] = turn, other
        starts.append(x)
    return starts


def _told(best: Fitted) -> LeverOutline:
    believed = best.believed
    hinge = replace(believed.hinge, delta=float(believed.turns[0]))
    return LeverOutline(hinge, ERRORS_SHARED * float(np.sqrt(best.covariance[4, 4])), believed.shape)


def _corners(shape: LeverShape) -> Array:
    """Of the box about a bar [m], (8, 3)."""
    local = np.array(list(product((shape.root_m, shape.end_m), *(np.outer(shape.half_m, (-1.0, 1.0))))))
    return shape.p_middle + local @ shape.frame.T
