"""Refined candidates in order of belief: evidence of both views plus physical preferences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.evidence import (
    COST_ON_SURFACE,
    Probe,
    Scene,
    behind_itself,
    carry,
    probe,
    score,
    turned_away,
)
from s2r_host.perception.motion import JointMotion, line_distance
from s2r_host.perception.refine import Refined, Side, refine, sides
from s2r_host.perception.standing import solid_m
from s2r_host.perception.view import DepthView, View
from s2r_host.perception.wishes import LONGEST_LEVER_M, Wishes

Array = NDArray[np.floating]

EVIDENCE_SCALE = 0.02  # cost difference that makes a hypothesis e times less likely
NEAR_GATE_M = 0.008
SAME_RAD, SAME_M = np.radians(0.5), 0.0005  # between motions that are one
SAME_COS = float(np.cos(SAME_RAD))
LEAST_JUDGED = 0.35  # of the moved points; a motion that hides nearly all of them explains nothing
LEAST_SEEN = 100  # moved points; with fewer a view tells nothing by itself
COST_ASKEW, ASKEW_RAD = 0.08, np.radians(15)  # one joint in fifty: e to the power of -4
# Levers rise by up to 43 degrees from the plane they turn in where that is level; where it is upright they swing beside
# what they are mounted on, and hardly lean away from it.
COST_ALONG, ACROSS_COS, ALONG_COS = 0.15, 0.68, 0.88
LEVEL_ACROSS_COS, LEVEL_ALONG_COS, LEVEL_RISE = 0.4, 0.65, 0.3
COST_IN_AIR, SOLID_M, AIR_M = 0.15, 0.028, 0.012  # of a lever's axis; true ones of drawn faucets have 28 mm
COST_SLIDING_LEVER = 0.04  # one thin part in ten slides
# Levers are mounted upright or level far more often than a little off. Of 24 drawn ones with the right motion
# (validation 1000 to 1029) evidence grew by 0.018 at most when such an axis was made exact, by 0.019 to 0.4 for those
# that lean by more than 5 degrees.
COST_OUT_OF_PLUMB, PLUMB_RAD = 0.02, np.radians(1.0)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One refined candidate: its cost (evidence + priors, 0 = perfect) and its share of belief."""

    motion: JointMotion
    cost: float
    evidence: float
    weight: float
    refined: Refined


def rank(
    starts: list[JointMotion],
    scene: Scene,
    wishes: Wishes,
    rng: np.random.Generator,
    *,
    near: Sequence[JointMotion] = (),
) -> list[Hypothesis]:
    """Refine all starts, judge them with finer evidence and priors, best first; those refined to one motion are one.

    ``near``: further ones that are within a centimetre of where they should be. Hinges of levers are tried upright or
    level as well, where they nearly are.
    """
    both = sides(scene, rng)
    found = [refine(start, both, wishes=wishes) for start in starts]
    found += [refine(start, both, first_gate_m=NEAR_GATE_M, wishes=wishes) for start in near]
    if wishes.thin:
        found += [_plumb(one.motion, both, wishes) for one in found if one is not None]
    refined = [one for one in found if one is not None]
    refined = [r for r in refined if _sensible(r.motion)]
    probes = (
        probe(scene.before, scene.moved_before(), 1200, rng),
        probe(scene.after, scene.moved_after(), 1200, rng),
    )
    evidence = score([r.motion for r in refined], scene, *probes, extra_m=0.001)
    cost = evidence + np.array([_prior(r.motion, scene, probes, wishes) for r in refined])
    order = _distinct([r.motion for r in refined], cost)
    weight = np.exp(-(cost - cost.min()) / EVIDENCE_SCALE) if len(cost) else cost
    total = max(weight[order].sum(), 1e-12)
    return [
        Hypothesis(
            refined[i].motion, float(cost[i]), float(evidence[i]), float(weight[i] / total), refined[i]
        )
        for i in order
    ]


def _distinct(motions: Sequence[JointMotion], cost: Array) -> list[int]:
    """Which of some motions, the cheapest first, are no earlier one again: one is not likelier for many starts."""
    kept: list[int] = []
    for i in np.argsort(cost, kind="stable"):
        if not any(_same(motions[i], motions[k]) for k in kept):
            kept.append(int(i))
    return kept


def _same(a: JointMotion, b: JointMotion) -> bool:
    if a.joint_type != b.joint_type or a.direction @ b.direction < SAME_COS:
        return False
    if a.joint_type == "prismatic":
        return abs(a.delta - b.delta) < SAME_M
    return (
        abs(a.delta - b.delta) < SAME_RAD and line_distance(a.origin, a.direction, b.origin[None])[0] < SAME_M
    )


def _plumb(motion: JointMotion, both: tuple[Side, Side], wishes: Wishes) -> Refined | None:
    """A hinge that is nearly upright or level, refined as one that was mounted so; None for others."""
    start = wishes.plumbed(motion)
    if start is None:
        return None
    found = refine(start, both, first_gate_m=NEAR_GATE_M, wishes=wishes.plumb())
    upright = wishes.up is not None and abs(float(start.direction @ wishes.up)) > 0.5
    return None if found is None else replace(found, exact=2 if upright else 1)


def _sensible(motion: JointMotion) -> bool:
    """Within what one push can do: less than 0.8 m or 160 degrees."""
    return motion.delta < (0.8 if motion.joint_type == "prismatic" else np.radians(160))


def _prior(motion: JointMotion, scene: Scene, probes: tuple[Probe, Probe], wishes: Wishes) -> float:
    """Physical preferences in units of cost: short motions, hinges near their part, upright or level, across levers."""
    if motion.joint_type == "prismatic":
        return 0.04 * motion.delta / 0.3 + (COST_SLIDING_LEVER if wishes.thin else 0.0)
    fits = _fitting_points(motion, scene, probes)
    if len(fits) == 0:
        return 0.1
    # Near the hinge the part moves less than the change test sees; so much distance is no evidence.
    blind = 0.012 / max(2 * np.sin(motion.delta / 2), 0.02)
    reach = float(np.percentile(line_distance(motion.origin, motion.direction, fits), 2))
    far = min(1.0, max(0.0, reach - 0.03 - blind) / 0.08)
    return (
        0.01
        + 0.06 * motion.delta / 1.5
        + 0.10 * far
        + _askew(motion, wishes)
        + _along_lever(motion, wishes)
        + (_in_air(motion, fits, scene, wishes.up) if scene.small() else 0.0)
    )


def _along_lever(motion: JointMotion, wishes: Wishes) -> float:
    """Cost of a hinge that runs along its lever: a bar tells sideways motion from a turn about such a line badly.

    So it does a turn about an upright line from one about a level line that halves the angle between its two places.
    Only a lever's: the edge of a lid is such a line too, longer, and its hinge does run along it.
    """
    lines = [
        line for line in (wishes.before, wishes.after) if line is not None and line.length_m < LONGEST_LEVER_M
    ]
    cosine = max((abs(float(motion.direction @ line.direction)) for line in lines), default=0.0)
    level = wishes.up is not None and abs(float(motion.direction @ wishes.up)) < LEVEL_RISE
    across, along = (LEVEL_ACROSS_COS, LEVEL_ALONG_COS) if level else (ACROSS_COS, ALONG_COS)
    return COST_ALONG * min(1.0, max(0.0, cosine - across) / (along - across))


def _in_air(motion: JointMotion, part: Array, scene: Scene, up: Array | None) -> float:
    """Cost of a lever's hinge that nothing seen holds."""
    return COST_IN_AIR * float(
        np.clip((SOLID_M - solid_m(motion, part, scene, up)) / (SOLID_M - AIR_M), 0.0, 1.0)
    )


def _askew(motion: JointMotion, wishes: Wishes) -> float:
    """Cost of a hinge that is neither upright nor level, and of a lever's that is not exactly that."""
    if wishes.up is None:
        return 0.0
    rise = float(np.arcsin(min(1.0, abs(float(motion.direction @ wishes.up)))))
    off = min(rise, np.pi / 2 - rise)
    exact = COST_OUT_OF_PLUMB * (1.0 - np.exp(-((off / PLUMB_RAD) ** 2))) if wishes.thin else 0.0
    return COST_ASKEW * min(1.0, off / ASKEW_RAD) ** 2 + exact


def _fitting_points(motion: JointMotion, scene: Scene, probes: tuple[Probe, Probe]) -> Array:
    """Surely moved points, in the pose of the first view, that land on a matching surface (n, 3).

    Of parts larger than a lever also those that the part hides then: a lid seen edge-on shows little near its hinge.
    """
    X = motion.transform()
    X_back = np.linalg.inv(X)
    small = scene.small()
    found = []
    for T, part, view, label, to_first in (
        (X, probes[0], scene.after, scene.changes.after, np.eye(4)),
        (X_back, probes[1], scene.before, scene.changes.before, X_back),
    ):
        if len(part.points):
            fits = carry(T[None], part, view, label, 0.001, small=small)[0] <= COST_ON_SURFACE
            fits |= False if small else behind_itself(T, part, view, label)
            found.append(part.points[fits] @ to_first[:3, :3].T + to_first[:3, 3])
    return np.concatenate(found)


@dataclass(frozen=True)
class Explained:
    """How much of what surely moved a motion explains.

    Attributes:
        share: Points whose cost is that of a matching surface, among those that can be judged.
        judged: Share of the points that can be judged.
        before: ``share`` of the first view's points alone; 1 where fewer than `LEAST_SEEN` of them can be judged, and
            for clouds without a camera.
        after: The same of the second view's.
    """

    share: float
    judged: float
    before: float
    after: float


def explained_by(best: Refined, scene: Scene, rng: np.random.Generator) -> Explained:
    """How much of what surely moved lands on a matching surface, a lever's own former one included.

    Of parts larger than a lever, points that the part itself hides (`behind_itself`) are left out, unless hardly any
    others are left.
    """
    probes = (
        probe(scene.before, scene.moved_before(), 1500, rng),
        probe(scene.after, scene.moved_after(), 1500, rng),
    )
    X = best.motion.transform()
    first = _in_other_view(X, probes[0], scene.after, scene.changes.after, scene, best)
    second = _in_other_view(np.linalg.inv(X), probes[1], scene.before, scene.changes.before, scene, best)
    both = first + second
    # Without a camera what was hidden counts as moved; no motion explains that.
    sure = isinstance(scene.before, DepthView) and isinstance(scene.after, DepthView)
    alone = [_share_alone(one) if sure else 1.0 for one in (first, second)]
    return Explained(_share(both), _judged(both) / max(int(both[0]), 1), *alone)


def _in_other_view(
    X: Array, part: Probe, view: View, label: NDArray[np.uint8], scene: Scene, best: Refined
) -> NDArray[np.int64]:
    """Of the points of one view, (3,): how many, how many land on a matching surface, how many cannot be judged."""
    count, small = len(part.points), scene.small()
    if not count:
        return np.zeros(3, dtype=np.int64)
    fitting = carry(X[None], part, view, label, 0.001, small=small)[0] <= COST_ON_SURFACE
    away = np.zeros(count, dtype=bool)
    if not small:
        away = behind_itself(X, part, view, label)
    elif best.plate_m is not None:
        away = turned_away(X, part, view)
    return np.array([count, fitting.sum(), (away & ~fitting).sum()])


def _judged(points: NDArray[np.int64]) -> float:
    count, _, away = points.tolist()
    return max(count - away, LEAST_JUDGED * count, 1)


def _share(points: NDArray[np.int64]) -> float:
    return float(points[1]) / _judged(points)


def _share_alone(points: NDArray[np.int64]) -> float:
    count, fitting, away = points.tolist()
    return 1.0 if count - away < LEAST_SEEN else fitting / (count - away)
