"""Several parts that moved between two views: told apart by their motions, then estimated one by one.

The motion that explains most of the change is found, what it explains is set aside, and the rest is searched again.
Then every changed point is given to the motion that carries it best, and each part is estimated anew by
`estimate_joint` with the points of the other parts taken out of both views, so that every check that holds for a
single part holds for each of several.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.change import Change
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.estimate import JointEstimate, estimate_joint, prepare, search
from s2r_host.perception.evidence import COST_ON_SURFACE, Probe, Scene, carry, probe
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.parallel import disbelief, lines_of, same_line, together
from s2r_host.perception.ranking import Hypothesis
from s2r_host.perception.verdict import moved_area, require_motion
from s2r_host.perception.view import DepthView, View

logger = logging.getLogger(__name__)

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

MOST_PARTS = 4
PROBED = 600  # changed points of either view by which sets of motions are judged
LEAST_REST = 0.15  # of the changed points; a smaller rest is no part
LEAST_FOLLOWS = 0.35  # of a rest must follow one motion for it to be a part's
LEAST_AREA_M2 = 2e-4  # of surface that follows it
SET_ASIDE_M = 0.006  # what lies so near to explained points goes with them
NEIGHBOURS = 9
NEAR_M = 0.03  # an undecided point farther from every decided one belongs to no part
MASK_PX = 5


def estimate_joints(
    before: DepthFrame, after: DepthFrame, *, most: int = MOST_PARTS, **options: Any
) -> tuple[JointEstimate, ...]:
    """Estimate the joint of every part that moved, largest part first.

    Args:
        before, after: Views with camera (clouds without one cannot be masked).
        most: Parts looked for.
        options: Those of `estimate_joint`.

    Raises:
        AbstainError: For one of the parts the views do not determine a joint; the text says for which.
        BadViewError: The views are no usable pair.
    """
    rng = np.random.default_rng(options.get("seed", 0))
    ignored = options.pop("ignore_mask_before", None), options.pop("ignore_mask_after", None)
    scene, _ = prepare(before, after, options.get("region"), *ignored, rng)
    require_motion(scene)
    motions = motions_of(scene, rng, most, options)
    if len(motions) < 2:
        return (
            estimate_joint(
                before, after, ignore_mask_before=ignored[0], ignore_mask_after=ignored[1], **options
            ),
        )
    owner = divide(scene, motions)
    logger.info("%d parts seem to have moved", len(motions))
    found = []
    for k in range(len(motions)):
        masks = [
            _others(view, who, k, old)
            for view, who, old in zip((scene.before, scene.after), owner, ignored, strict=True)
        ]
        beside = [
            one.axis_direction
            for one in found
            if one.joint_type == "prismatic" and same_line(one.axis_direction, motions[k])
        ]
        try:
            found.append(
                estimate_joint(
                    before,
                    after,
                    ignore_mask_before=masks[0],
                    ignore_mask_after=masks[1],
                    beside=beside[:1],
                    **options,
                )
            )
        except AbstainError as error:
            raise AbstainError(f"{len(motions)} parts moved; of part {k + 1}: {error}") from error
    return tuple(found)


def motions_of(
    scene: Scene, rng: np.random.Generator, most: int, options: Mapping[str, Any]
) -> list[JointMotion]:
    """Different motions that together explain the change, most explained first.

    Parts are looked for one after the other, and slides along each line that something may have slid along together;
    the set that explains the views best is taken.
    """
    kept = {name: options[name] for name in ("joint_type", "up") if name in options}
    first = search(scene, rng, **kept).ranked
    probes = (
        probe(scene.before, scene.moved_before(), PROBED, rng),
        probe(scene.after, scene.moved_after(), PROBED, rng),
    )
    lines = lines_of([one.motion.direction for one in first if one.motion.joint_type == "prismatic"])
    sets = [
        _one_by_one(first, scene, rng, most, kept),
        *(together(line, scene, probes, most) for line in lines),
    ]
    best = min((one for one in sets if one), key=lambda one: disbelief(one, scene, probes), default=[])
    return _most_followed_first(best, scene)


def _one_by_one(
    ranked: list[Hypothesis], scene: Scene, rng: np.random.Generator, most: int, kept: dict[str, Any]
) -> list[JointMotion]:
    """The motion that explains most, then that which explains most of what is left, and so on."""
    total = len(scene.moved_before()) + len(scene.moved_after())
    found: list[JointMotion] = []
    rest = scene
    while len(found) < most:
        moved = rest.moved_before(), rest.moved_after()
        if len(moved[0]) + len(moved[1]) < LEAST_REST * total or max(_areas(rest)) < LEAST_AREA_M2:
            break
        ranked = ranked if rest is scene else search(rest, rng, **kept).ranked
        if not ranked:
            break
        motion = ranked[0].motion
        follows = tuple(carried(motion, rest, index, k) for k, index in enumerate(moved))
        share = (follows[0].sum() + follows[1].sum()) / (len(moved[0]) + len(moved[1]))
        if share < LEAST_FOLLOWS:
            break
        found.append(motion)
        rest = replace(
            rest,
            candidate_before=rest.candidate_before & ~_beside(rest.before, moved[0][follows[0]]),
            candidate_after=rest.candidate_after & ~_beside(rest.after, moved[1][follows[1]]),
        )
    return found


def _most_followed_first(motions: list[JointMotion], scene: Scene) -> list[JointMotion]:
    """Motions in order of how many changed points follow each of them, and none of the others better."""
    if len(motions) < 2:
        return motions
    count = np.zeros(len(motions), dtype=np.int64)
    for side, index in enumerate((scene.moved_before(), scene.moved_after())):
        cost = np.stack([cost_of(one, scene, index, side) for one in motions])
        clear = cost.min(axis=0) <= COST_ON_SURFACE
        count += np.bincount(cost.argmin(axis=0)[clear], minlength=len(motions))
    return [motions[k] for k in np.argsort(-count, kind="stable")]


def carried(motion: JointMotion, scene: Scene, index: NDArray[np.int64], side: int) -> Mask:
    """Which of the points with these indices (side 0: first view, 1: second) land on a matching surface."""
    return cost_of(motion, scene, index, side) <= COST_ON_SURFACE


def cost_of(motion: JointMotion, scene: Scene, index: NDArray[np.int64], side: int) -> Array:
    """What each of the points costs when carried into the other view, shape (points,)."""
    if len(index) == 0:
        return np.zeros(0)
    X = motion.transform()
    here, there, label = (
        (scene.before, scene.after, scene.changes.after),
        (scene.after, scene.before, scene.changes.before),
    )[side]
    part = Probe(
        here.points[index], here.normals[index], here.normal_ok[index], here.sigma_m[index],
        np.zeros((len(index), 0)), here.oriented,
    )  # fmt: skip
    return carry((X if side == 0 else np.linalg.inv(X))[None], part, there, label, 0.001)[0]


def divide(scene: Scene, motions: list[JointMotion]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of the motion each point of both views follows, -1 for none; shapes (points,).

    Changed points go where they cost least; what is undecided, and what hides or did not change for sure, follows its
    nearest decided neighbours.
    """
    owners = []
    for side, view, moved, label in (
        (0, scene.before, scene.moved_before(), scene.changes.before),
        (1, scene.after, scene.moved_after(), scene.changes.after),
    ):
        cost = np.stack([cost_of(motion, scene, moved, side) for motion in motions])
        best = cost.argmin(axis=0)
        clear = cost.min(axis=0) <= COST_ON_SURFACE
        owner = np.full(len(view.points), -1, dtype=np.int64)
        if clear.any():
            tree = cKDTree(view.points[moved[clear]])
            open_points = np.flatnonzero(label != Change.STATIC)
            distance, near = tree.query(view.points[open_points], k=NEIGHBOURS, distance_upper_bound=NEAR_M)
            votes = np.zeros((len(open_points), len(motions)))
            valid = np.isfinite(distance)
            of = best[clear][np.where(valid, near, 0)]
            for k in range(len(motions)):
                votes[:, k] = (valid & (of == k)).sum(axis=1)
            owner[open_points] = np.where(votes.any(axis=1), votes.argmax(axis=1), -1)
        owners.append(owner)
    return owners[0], owners[1]


def _others(view: View, owner: NDArray[np.int64], own: int, ignored: Mask | None) -> Mask:
    """Pixels to forget: those of the other parts, widened a little, but none of the part itself."""
    assert isinstance(view, DepthView)
    others = view.image((owner >= 0) & (owner != own)).astype(np.uint8)
    mine = view.image(owner == own).astype(bool)
    mask = cv2.dilate(others, np.ones((MASK_PX, MASK_PX), np.uint8)).astype(bool) & ~mine
    return mask if ignored is None else mask | ignored


def _beside(view: View, index: NDArray[np.int64]) -> Mask:
    """Points of a view within `SET_ASIDE_M` of some of its points."""
    if len(index) == 0:
        return np.zeros(len(view.points), dtype=bool)
    distance, _ = cKDTree(view.points[index]).query(view.points, distance_upper_bound=SET_ASIDE_M)
    return np.isfinite(np.asarray(distance))


def _areas(scene: Scene) -> tuple[float, float]:
    return moved_area(scene.before, scene.moved_before()), moved_area(scene.after, scene.moved_after())
