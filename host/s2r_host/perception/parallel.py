"""Slides along one line: drawers of one chest, of which several went different ways at once.

Two fronts that changed places look much like one that went sideways, and how far the second of two drawers went is
hardly seen in what the first leaves over. So all of them are looked for together: along one direction every changed
point is carried by every amount, and those few amounts are taken that explain most of the points between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.evidence import (
    COST_FOREIGN,
    COST_ON_SURFACE,
    COST_UNSEEN,
    Probe,
    Scene,
    carry,
    subset,
)
from s2r_host.perception.motion import JointMotion

Array = NDArray[np.floating]

FARTHEST_M, STEP_M, FINE_STEP_M = 0.36, 0.002, 0.0005
LEAST_GAIN = 0.03  # in cost, by a further part
LEAST_OWN = 0.1  # of the points that face along a line, by each of the slides along it
FACING_COS = 0.6
LEAST_APART_M = 0.012  # between two amounts; rigid parts that move alike are one part
COST_LENGTH, COST_TURN = 0.04 / 0.3, 0.06 / 1.5  # per metre and radian, as of one part's motion (`ranking`)
COST_LEAP, LEAP_SHARE, LEAST_LEAPING = 0.12, 0.8, 20
# Faces square to a slide, and the share of a part's points that a front has at least: closing drawers show sides and
# bottom, too (0.37 and more of those looked at), leaps hardly any (0.18).
FRONT_COS, LEAST_FRONT = 0.8, 0.25
COST_ACROSS, COST_ASKEW, ASKEW_COS = 0.12, 0.02, float(np.cos(np.radians(0.3)))
SAME_LINE_COS = float(np.cos(np.radians(5.0)))


def together(line: Array, scene: Scene, probes: tuple[Probe, Probe], most: int) -> list[JointMotion]:
    """The slides along a line that explain the changed points together.

    Only points of faces square to the line count: the others land on their own face by any amount. One slide is
    answered wherever there are any; another joins where it alone explains a good part of them.

    Args:
        line: Unit vector, (3,).
        scene: Both views.
        probes: Changed points of either view.
        most: Slides at most.
    """
    probes = (_facing(line, probes[0]), _facing(line, probes[1]))
    if not len(probes[0].points) + len(probes[1].points):
        return []
    amounts = np.arange(-FARTHEST_M, FARTHEST_M + STEP_M, STEP_M)
    cost, weight = _costs(line, amounts, scene, probes)
    found = [int((cost @ weight).argmin())]
    if most > 1:
        pairs = np.array([np.minimum(one, cost) @ weight for one in cost])
        pairs[np.abs(amounts[:, None] - amounts) < LEAST_APART_M] = np.inf
        both = [int(k) for k in np.unravel_index(int(pairs.argmin()), pairs.shape)]
        found = both if _each_is_a_part(cost, weight, both) else found
    while 1 < len(found) < most:
        more = np.minimum(cost[found].min(axis=0), cost) @ weight
        more[np.abs(amounts[:, None] - amounts[found]).min(axis=1) < LEAST_APART_M] = np.inf
        longer = [*found, int(more.argmin())]
        if not _each_is_a_part(cost, weight, longer):
            break
        found = longer
    best = [_finer(line, float(amounts[k]), k, found, cost, scene, probes) for k in found]
    origin = scene.moved_points().mean(axis=0)
    return [JointMotion("prismatic", origin, line, one).positive() for one in best]


def _facing(line: Array, part: Probe) -> Probe:
    return subset(part, part.normal_ok & (np.abs(part.normals @ line) > FACING_COS))


def _each_is_a_part(cost: Array, weight: Array, found: list[int]) -> bool:
    """Whether each of some amounts explains points that none of the others does, `LEAST_OWN` of all."""
    for k in found:
        others = cost[[other for other in found if other != k]].min(axis=0)
        if weight @ ((cost[k] <= COST_ON_SURFACE) & (others >= COST_UNSEEN)) < LEAST_OWN:
            return False
    return True


def disbelief(motions: Sequence[JointMotion], scene: Scene, probes: tuple[Probe, Probe]) -> float:
    """How badly some motions explain the views together: mean cost of the changed points where each follows the motion
    that suits it best, and what speaks beforehand against so many parts, long motions, slides askew and leaps.

    A leap is a slide along the part's own faces that is as long as the part: nothing was left where it had been, and
    what stands there now is its like.
    """
    cost, weight = _carried(np.stack([one.transform() for one in motions]), scene, probes)
    before = cost[:, : len(probes[0].points)]
    slides = [k for k, one in enumerate(motions) if one.joint_type == "prismatic"]
    length = sum(one.delta * (COST_LENGTH if one.joint_type == "prismatic" else COST_TURN) for one in motions)
    askew = _askew([motions[k].direction for k in slides])
    own = [(before.argmin(axis=0) == k) & (before[k] <= COST_ON_SURFACE) for k in slides]
    leaps = any(_leaps(motions[k], probes[0], one) for k, one in zip(slides, own, strict=True))
    prior = LEAST_GAIN * (len(motions) - 1) + length + askew + COST_LEAP * leaps
    return float(cost.min(axis=0) @ weight) + prior


def _askew(directions: Sequence[Array]) -> float:
    """Cost of slides that are not parallel: those of one object mostly are, and then they are it exactly."""
    cosines = [abs(float(a @ b)) for a, b in combinations(directions, 2)]
    if any(one < SAME_LINE_COS for one in cosines):
        return COST_ACROSS
    return COST_ASKEW if any(one < ASKEW_COS for one in cosines) else 0.0


def _leaps(motion: JointMotion, part: Probe, own: NDArray[np.bool_]) -> bool:
    if own.sum() < LEAST_LEAPING:
        return False
    along = np.abs(part.normals[own & part.normal_ok] @ motion.direction)
    low, high = np.percentile(part.points[own] @ motion.direction, [2, 98])
    no_front = len(along) > 0 and np.mean(along > FRONT_COS) < LEAST_FRONT
    return bool(no_front and motion.delta > LEAP_SHARE * (high - low))


def lines_of(directions: Sequence[Array]) -> list[Array]:
    """Directions (3,) without those within 5 degrees of an earlier one, or of its opposite."""
    kept: list[Array] = []
    for one in directions:
        if all(abs(float(one @ other)) < SAME_LINE_COS for other in kept):
            kept.append(one)
    return kept


def same_line(direction: Array, motion: JointMotion) -> bool:
    """Whether a motion is a slide within 5 degrees of a direction (3,) or of its opposite."""
    return motion.joint_type == "prismatic" and abs(float(direction @ motion.direction)) > SAME_LINE_COS


def _finer(
    line: Array,
    amount: float,
    own: int,
    found: list[int],
    cost: Array,
    scene: Scene,
    probes: tuple[Probe, Probe],
) -> float:
    """An amount to half a millimetre, by the points that none of the others explains better."""
    near = amount + np.arange(-STEP_M, STEP_M + FINE_STEP_M, FINE_STEP_M)
    others = [k for k in found if k != own]
    mine = cost[own] < cost[others].min(axis=0) if others else np.ones(cost.shape[1], dtype=bool)
    fine, weight = _costs(line, near, scene, probes)
    return float(near[int((fine[:, mine] @ weight[mine]).argmin())])


def _costs(line: Array, amounts: Array, scene: Scene, probes: tuple[Probe, Probe]) -> tuple[Array, Array]:
    X = np.tile(np.eye(4), (len(amounts), 1, 1))
    X[:, :3, 3] = amounts[:, None] * line
    return _carried(X, scene, probes)


def _carried(X: Array, scene: Scene, probes: tuple[Probe, Probe]) -> tuple[Array, Array]:
    """Cost per motion (m, 4, 4) and changed point, shape (m, points); weights of the points, both views alike."""
    before = carry(X, probes[0], scene.after, scene.changes.after, 0.5 * STEP_M)
    after = carry(np.linalg.inv(X), probes[1], scene.before, scene.changes.before, 0.5 * STEP_M)
    views = [one for one in (before, after) if one.shape[1]]
    weight = np.concatenate([np.full(one.shape[1], 1.0 / (len(views) * one.shape[1])) for one in views])
    return np.minimum(np.concatenate(views, axis=1), COST_FOREIGN), weight
