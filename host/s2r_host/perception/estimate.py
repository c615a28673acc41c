"""Estimate the one joint that moved between two views.

Steps: label changes → hypotheses from structure → scan with free-space evidence → two-way refinement of the
best few → choice by evidence and physical priors → parts, intervals, or a reasoned abstention.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception import hypotheses as hyp
from s2r_host.perception.change import compare, measured_noise_scale, without_specks
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.evidence import (
    COST_ON_SURFACE,
    THICKEST_M,
    Probe,
    Scene,
    carry,
    probe,
    score,
    turned_away,
)
from s2r_host.perception.frames import Cloud, DepthFrame
from s2r_host.perception.intervals import Intervals, intervals90
from s2r_host.perception.motion import JointMotion, JointType, line_distance
from s2r_host.perception.refine import Refined, refine, sides
from s2r_host.perception.sanity import check_pair, check_same_camera, check_second_part
from s2r_host.perception.segment import Parts, segment
from s2r_host.perception.view import CloudView, DepthView, View
from s2r_host.perception.wishes import Wishes

logger = logging.getLogger(__name__)

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Region = tuple[float, float, float, float, float, float]

REFINED_HYPOTHESES = 15
EVIDENCE_SCALE = 0.02  # cost difference that makes a hypothesis e times less likely
FAMILY_MARGIN = 0.02  # cost; below it revolute and prismatic are not told apart
MOST_RESIDUAL_M = 0.003
LEAST_TRAVEL_M = 0.010  # of the fastest point of the part
MOST_TILT_RAD = np.radians(15)
LEAST_EXPLAINED = 0.5  # with hands on the object 0.5-0.75; a plate taken for its own mirror image 0.3-0.48
LEAST_MOVED_M2 = 1e-4
LEAST_PLATE_M = 0.001  # thinner: the faces were taken for one
LEAST_JUDGED = 0.35  # of the moved points; a motion that hides nearly all of them explains nothing
COST_ASKEW, ASKEW_RAD = 0.08, np.radians(15)  # one joint in fifty: e to the power of -4
COST_SLIDING_LEVER = 0.04  # one thin part in ten slides
# Half of a lever's pixels lie on rims and carry no surface.
THIN_EXPLAINED, THIN_EVIDENCE = 0.33, 0.45
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One refined candidate: its cost (evidence + priors, 0 = perfect) and its share of belief."""

    motion: JointMotion
    cost: float
    evidence: float
    weight: float
    refined: Refined


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """The joint that explains both views.

    Attributes:
        joint_type: "revolute" or "prismatic".
        axis_origin_m: Point on the axis (for a slide: centre of the part), frame of the views, shape (3,).
        axis_direction: Unit vector; its sense is that of the motion seen, shape (3,).
        delta: Motion from the first to the second view, >= 0 [rad or m].
        unit: "rad" or "m".
        intervals90: Half-open 90 % intervals.
        residual_m: Robust point-to-plane spread after alignment [m].
        view_before, view_after: The prepared views.
        parts: Masks of the moving part over the points of both views.
        hypotheses: All refined candidates, best first.
        explained: Share of the surely moved points that land on a matching surface.
        warnings: Sentences for the user.
    """

    joint_type: JointType
    axis_origin_m: Array
    axis_direction: Array
    delta: float
    unit: Literal["rad", "m"]
    intervals90: Intervals
    residual_m: float
    view_before: View
    view_after: View
    parts: Parts
    hypotheses: tuple[Hypothesis, ...]
    explained: float
    warnings: tuple[str, ...]

    @property
    def motion(self) -> JointMotion:
        """The estimate as a motion."""
        return JointMotion(self.joint_type, self.axis_origin_m, self.axis_direction, self.delta)

    @property
    def moved_mask_before(self) -> Mask:
        """Part pixels of the first view (h, w) of the given depth image; (n,) for a cloud."""
        return _as_image(self.view_before, self.parts.before)

    @property
    def moved_mask_after(self) -> Mask:
        """Part pixels of the second view, like `moved_mask_before`."""
        return _as_image(self.view_after, self.parts.after)

    def reversed(self) -> JointEstimate:
        """The same joint with the opposite sense: the direction is flipped and delta becomes negative."""
        low, high = self.intervals90.delta
        return replace(
            self,
            axis_direction=-self.axis_direction,
            delta=-self.delta,
            intervals90=replace(self.intervals90, delta=(-high, -low)),
        )


def estimate_joint(
    before: DepthFrame | Cloud,
    after: DepthFrame | Cloud,
    *,
    region: Region | None = None,
    ignore_mask_before: Mask | None = None,
    ignore_mask_after: Mask | None = None,
    extra_axes: Sequence[hyp.Axis] = (),
    joint_type: JointType | None = None,
    up: Array | None = UP,
    seed: int = 0,
) -> JointEstimate:
    """Estimate type, axis and motion of the one part that moved.

    Args:
        before: First view.
        after: Second view, in the same frame; the camera may stand elsewhere if its pose is known.
        region: Box (xmin, xmax, ymin, ymax, zmin, zmax) [m] in which to look for motion.
        ignore_mask_before: Pixels (h, w) of the first view to forget, e.g. the robot.
        ignore_mask_after: The same for the second view.
        extra_axes: More candidate axes, e.g. the modes of a network.
        joint_type: Consider only this family (a user who knows it is a drawer may say so).
        up: Unit vector against gravity in the frame of the views, None if unknown: most hinges are upright or level.
        seed: Of the sampling.

    Raises:
        AbstainError: The views do not determine one joint; the text says why and what to do.
        BadViewError: The views are no usable pair.
    """
    rng = np.random.default_rng(seed)
    view_a, view_b, warnings = _views(before, after, ignore_mask_before, ignore_mask_after, rng)
    check_pair(view_a, view_b)
    changes = without_specks(view_a, view_b, compare(view_a, view_b))
    scene = Scene(view_a, view_b, changes, _in_region(view_a, region), _in_region(view_b, region))
    _require_motion(scene)
    # Nearest neighbours in a bare cloud cost ten times a projection.
    few = 300 if isinstance(view_a, DepthView) and isinstance(view_b, DepthView) else 100
    probes = probe(view_a, scene.moved_before(), few, rng), probe(view_b, scene.moved_after(), few, rng)
    shape = hyp.structure(scene, rng, up)
    found = [*extra_axes, *hyp.axes(shape)]
    if joint_type is not None:
        found = [axis for axis in found if axis.joint_type == joint_type]
    motions, cost = hyp.scan(found, scene, *probes)
    anchors = np.concatenate([probes[0].points[:100], probes[1].points[:100]])
    starts = hyp.best_distinct(motions, cost, anchors, REFINED_HYPOTHESES)
    wishes = Wishes(shape.fronts(), up, *shape.levers)
    ranked = _rank([m for m, _ in starts], scene, wishes, rng)
    if not ranked:
        check_same_camera(view_a, view_b, changes, np.ones(len(view_a.points), dtype=bool), rng)
        raise AbstainError(
            "no single joint motion carries the first view onto the second; is the part rigid?"
        )
    best = ranked[0]
    parts = segment(scene, best.motion)
    explained = _explained(best.refined, scene, rng)
    check_same_camera(view_a, view_b, changes, ~parts.before, rng)
    fine = probe(view_a, scene.moved_before(), 1000, rng), probe(view_b, scene.moved_after(), 1000, rng)
    check_second_part(best.motion, motions, scene, sides(scene, rng), fine, rng)
    warnings += _judge(ranked, scene, parts, explained, wishes.thin)
    centre = view_a.points[parts.before].mean(axis=0) if parts.before.any() else best.motion.origin
    noise_m = float(np.median(view_a.sigma_m[parts.before])) if parts.before.any() else 0.0015
    intervals = intervals90([(h.refined, h.weight) for h in ranked], centre, noise_m, wishes.thin)
    _require_narrow(intervals, best.motion)
    motion = _with_origin_near(best.motion, centre)
    logger.info(
        "joint %s, delta %.4f, residual %.2f mm, cost %.3f of %d hypotheses",
        motion.joint_type, motion.delta, best.refined.residual_m * 1e3, best.cost, len(ranked),
    )  # fmt: skip
    return JointEstimate(
        motion.joint_type, motion.origin, motion.direction, motion.delta,
        "rad" if motion.joint_type == "revolute" else "m",
        intervals, best.refined.residual_m, view_a, view_b, parts, tuple(ranked), explained, tuple(warnings),
    )  # fmt: skip


def _views(
    before: DepthFrame | Cloud, after: DepthFrame | Cloud, ignore_a: Mask | None, ignore_b: Mask | None,
    rng: np.random.Generator,
) -> tuple[View, View, list[str]]:  # fmt: skip
    warnings: list[str] = []
    if isinstance(before, DepthFrame) and isinstance(after, DepthFrame):
        a, b = DepthView(before, ignore_a), DepthView(after, ignore_b)
        same = a.shape == b.shape and np.allclose(a.K, b.K) and np.allclose(a.X_base_camera, b.X_base_camera)
        if same:
            scale = measured_noise_scale(a, b)
            if abs(scale - 1.0) > 0.15:
                a, b = DepthView(before, ignore_a, scale), DepthView(after, ignore_b, scale)
        return a, b, warnings
    warnings.append(
        "at least one view is a cloud without a camera: free space is unknown, give --camera for a surer answer"
    )
    return _one_view(before, ignore_a, rng), _one_view(after, ignore_b, rng), warnings


def _one_view(frame: DepthFrame | Cloud, ignore: Mask | None, rng: np.random.Generator) -> View:
    if isinstance(frame, DepthFrame):
        return DepthView(frame, ignore)
    return CloudView(frame, rng)


def _in_region(view: View, region: Region | None) -> Mask:
    if region is None:
        return np.ones(len(view.points), dtype=bool)
    low, high = np.array(region[0::2]), np.array(region[1::2])
    return np.all((view.points >= low) & (view.points <= high), axis=1)


def _require_motion(scene: Scene) -> None:
    area = max(_area(scene.before, scene.moved_before()), _area(scene.after, scene.moved_after()))
    if area < LEAST_MOVED_M2:
        raise AbstainError(
            f"no motion seen: {area * 1e4:.1f} cm² of surface changed, at least {LEAST_MOVED_M2 * 1e4:.0f} cm² are"
            " needed; move the part further (3 cm or 15 degrees) between the views"
        )


def _area(view: View, index: NDArray[np.int64]) -> float:
    """Surface seen at these points [m²] (pixel footprint, or spacing squared for clouds)."""
    if len(index) == 0:
        return 0.0
    if isinstance(view, DepthView):
        z = view.points[index] @ view.X_camera_base[2, :3] + view.X_camera_base[2, 3]
        return float((z**2).sum() / (view.K[0, 0] * view.K[1, 1]))
    assert isinstance(view, CloudView)
    return float(len(index) * view.spacing_m**2)


def _rank(
    starts: list[JointMotion], scene: Scene, wishes: Wishes, rng: np.random.Generator
) -> list[Hypothesis]:
    """Refine all starts, judge them with finer evidence and priors, best first."""
    both = sides(scene, rng)
    refined = [r for r in (refine(start, both, wishes=wishes) for start in starts) if r is not None]
    refined = [r for r in refined if _sensible(r.motion)]
    probes = (
        probe(scene.before, scene.moved_before(), 1200, rng),
        probe(scene.after, scene.moved_after(), 1200, rng),
    )
    evidence = score([r.motion for r in refined], scene, *probes, extra_m=0.001)
    cost = evidence + np.array([_prior(r.motion, scene, probes, wishes) for r in refined])
    order = np.argsort(cost, kind="stable")
    weight = np.exp(-(cost - cost.min()) / EVIDENCE_SCALE) if len(cost) else cost
    weight = weight / max(weight.sum(), 1e-12)
    return [
        Hypothesis(refined[i].motion, float(cost[i]), float(evidence[i]), float(weight[i]), refined[i])
        for i in order
    ]


def _sensible(motion: JointMotion) -> bool:
    """Within what one push can do: less than 0.8 m or 160 degrees."""
    return motion.delta < (0.8 if motion.joint_type == "prismatic" else np.radians(160))


def _prior(motion: JointMotion, scene: Scene, probes: tuple[Probe, Probe], wishes: Wishes) -> float:
    """Physical preferences in units of cost: short motions, hinges near their part, upright or level."""
    if motion.joint_type == "prismatic":
        return 0.04 * motion.delta / 0.3 + (COST_SLIDING_LEVER if wishes.thin else 0.0)
    fits = _fitting_points(motion, scene, probes)
    if len(fits) == 0:
        return 0.1
    # Near the hinge the part moves less than the change test sees; so much distance is no evidence.
    blind = 0.012 / max(2 * np.sin(motion.delta / 2), 0.02)
    reach = float(np.percentile(line_distance(motion.origin, motion.direction, fits), 2))
    far = min(1.0, max(0.0, reach - 0.03 - blind) / 0.08)
    return 0.01 + 0.06 * motion.delta / 1.5 + 0.10 * far + _askew(motion, wishes.up)


def _askew(motion: JointMotion, up: Array | None) -> float:
    """Cost of a hinge that is neither upright nor level."""
    if up is None:
        return 0.0
    off = float(np.arcsin(min(1.0, abs(float(motion.direction @ up)))))
    return COST_ASKEW * min(1.0, min(off, np.pi / 2 - off) / ASKEW_RAD) ** 2


def _fitting_points(motion: JointMotion, scene: Scene, probes: tuple[Probe, Probe]) -> Array:
    """Surely moved points, in the pose of the first view, that land on a matching surface (n, 3)."""
    X = motion.transform()
    X_back = np.linalg.inv(X)
    found = []
    if len(probes[0].points):
        cost = carry(X[None], probes[0], scene.after, scene.changes.after, 0.001)[0]
        found.append(probes[0].points[cost <= COST_ON_SURFACE])
    if len(probes[1].points):
        cost = carry(X_back[None], probes[1], scene.before, scene.changes.before, 0.001)[0]
        found.append((probes[1].points @ X_back[:3, :3].T + X_back[:3, 3])[cost <= COST_ON_SURFACE])
    return np.concatenate(found)


def _explained(best: Refined, scene: Scene, rng: np.random.Generator) -> float:
    """Share of surely moved points whose cost is that of a matching surface.

    Of a plate that turned over, points turned away from the camera are left out, unless hardly any others are left.
    """
    probes = (
        probe(scene.before, scene.moved_before(), 1500, rng),
        probe(scene.after, scene.moved_after(), 1500, rng),
    )
    count = len(probes[0].points) + len(probes[1].points)
    X, fits, away = best.motion.transform(), 0, 0
    for T, part, view, label in (
        (X, probes[0], scene.after, scene.changes.after),
        (np.linalg.inv(X), probes[1], scene.before, scene.changes.before),
    ):
        if len(part.points):
            fitting = carry(T[None], part, view, label, 0.001)[0] <= COST_ON_SURFACE
            fits += int(fitting.sum())
            if best.plate_m is not None:
                away += int((turned_away(T, part, view) & ~fitting).sum())
    return fits / max(count - away, LEAST_JUDGED * count, 1)


def _judge(ranked: list[Hypothesis], scene: Scene, parts: Parts, explained: float, thin: bool) -> list[str]:
    """Abstain where the evidence does not carry; else warnings."""
    best = ranked[0]
    X = best.motion.transform()
    travel = np.linalg.norm(scene.before.points[parts.before] @ (X[:3, :3] - np.eye(3)).T + X[:3, 3], axis=1)
    most_travel = float(np.percentile(travel, 98)) if travel.size else 0.0
    if thin:  # half of a lever's pixels lie on its rims and carry no surface
        clear = explained >= THIN_EXPLAINED and best.evidence < THIN_EVIDENCE
    else:
        clear = explained >= LEAST_EXPLAINED
    if travel.size < 100 or not clear:
        raise AbstainError(
            f"no single rigid motion explains the change: the best one explains {100 * explained:.0f} % of the moved"
            " points; remove hands and other moving things, give --region, or show the same side of the part twice"
        )
    if most_travel < LEAST_TRAVEL_M:
        raise AbstainError(
            f"the motion is too small: {most_travel * 1e3:.1f} mm at its fastest point, at least"
            f" {LEAST_TRAVEL_M * 1e3:.0f} mm are needed; push further (3 cm or 15 degrees)"
        )
    if best.refined.residual_m > MOST_RESIDUAL_M:
        raise AbstainError(
            f"the best {best.motion.joint_type} joint leaves a residual of {best.refined.residual_m * 1e3:.1f} mm,"
            f" limit {MOST_RESIDUAL_M * 1e3:.0f} mm; is the part rigid and the camera calibrated?"
        )
    plate = best.refined.plate_m
    if plate is not None and not LEAST_PLATE_M < plate < THICKEST_M:
        raise AbstainError(
            "the part shows one face before and the other after, and its thickness cannot be told from them"
            f" ({plate * 1e3:.0f} mm fits best); push so that one face stays in sight, or look from another side"
        )
    other = next((h for h in ranked if h.motion.joint_type != best.motion.joint_type), None)
    if other is not None and other.cost - best.cost < FAMILY_MARGIN:
        raise AbstainError(
            f"{best.motion.joint_type} and {other.motion.joint_type} explain the motion about equally well (cost"
            f" {best.cost:.3f} and {other.cost:.3f}); push further so that the two differ"
        )
    warnings = []
    if plate is not None:
        warnings.append(
            f"the part shows one face before and the other after: {plate * 1e3:.0f} mm thick at a guess, so the hinge"
            " is less certain"
        )
    if most_travel < 0.03:
        warnings.append(
            f"small motion ({most_travel * 1e3:.0f} mm at most): the axis is uncertain, push 3 cm or more"
        )
    if explained < 0.6:
        warnings.append(
            f"only {100 * explained:.0f} % of the moved points fit the joint; something else moved too"
        )
    return warnings


def _require_narrow(intervals: Intervals, motion: JointMotion) -> None:
    half = 0.5 * (intervals.delta[1] - intervals.delta[0])
    if intervals.axis_angle_rad > MOST_TILT_RAD or half > 0.5 * motion.delta:
        raise AbstainError(
            f"several {motion.joint_type} motions explain the views: the axis is known to"
            f" {np.degrees(intervals.axis_angle_rad):.0f} degrees and the motion to {100 * half / motion.delta:.0f} %"
            " only; push further or look from another side"
        )


def _with_origin_near(motion: JointMotion, centre: Array) -> JointMotion:
    """Slide the origin along the axis to the part (hinge), or put it at the part's centre (slide)."""
    if motion.joint_type == "prismatic":
        return replace(motion, origin=centre)
    along = (centre - motion.origin) @ motion.direction
    return replace(motion, origin=motion.origin + along * motion.direction)


def _as_image(view: View, mask: Mask) -> Mask:
    return view.image(mask).astype(bool) if isinstance(view, DepthView) else mask
