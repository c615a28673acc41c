"""Estimate the one joint that moved between two views.

Steps: label changes → hypotheses from structure → scan with free-space evidence → two-way refinement of the
best few → choice by evidence and physical priors → parts, intervals, or a reasoned abstention.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception import hypotheses as hyp
from s2r_host.perception.change import compare, measured_noise_scale, with_shadows, without_specks
from s2r_host.perception.errors import AbstainError, BadViewError
from s2r_host.perception.evidence import (
    Probe,
    Scene,
    probe,
)
from s2r_host.perception.frames import Cloud, DepthFrame
from s2r_host.perception.intervals import Z90, Intervals, intervals90
from s2r_host.perception.lever_outline import LeverOutline, lever_outline
from s2r_host.perception.lever_shape import LeverShape
from s2r_host.perception.levers import line_within
from s2r_host.perception.line import HUB_M
from s2r_host.perception.motion import JointMotion, Push, line_distance
from s2r_host.perception.network_belief import Belief, Network, weighed_by
from s2r_host.perception.ranking import Hypothesis, explained_by, rank
from s2r_host.perception.refine import sides
from s2r_host.perception.revealed import with_revealed_level
from s2r_host.perception.sampled import sampled
from s2r_host.perception.sanity import check_pair, check_same_camera, check_second_part
from s2r_host.perception.segment import Parts, segment
from s2r_host.perception.symmetry import other_turn, refuse_two_turns, spokes
from s2r_host.perception.verdict import (
    KNOWN_TO,
    LEAST_MOVED_M2,
    area_of_motion,
    judge,
    require_motion,
    require_narrow,
    require_standing,
)
from s2r_host.perception.view import CloudView, DepthView, View
from s2r_host.perception.wishes import Wishes
from s2r_protocol.targets import JointType

if TYPE_CHECKING:
    from s2r_host.perception.knob_outline import KnobOutline

logger = logging.getLogger(__name__)

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Region = tuple[float, float, float, float, float, float]

REFINED_HYPOTHESES = 15
LEAST_CARRIED = 0.7  # of the moved points; a motion that explains fewer tells badly what is the part's
AGAIN = 8  # of them that are refined again once the whole lever is known
EDGE_ON_JUDGED = 0.7  # of the moved points; fewer can be judged where a plate is seen edge-on
EDGE_ON_USED = 1200  # surface points in the refinement, of the 5000 or so of a lid seen well
# Of 39 faucets (validation 1100 to 1138) geometry knew seven turns too vaguely. Five of them it knew to a fifth and the
# network agreed: the hinges were 1 to 5 mm off. The other two were 24 mm off and reversed.
KNOWN_TO_BOTH, AGREES_NATS = 0.2, -0.6
UP = np.array([0.0, 0.0, 1.0])


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
        up: Unit vector against gravity, as it was given; None if unknown.
        knob: The moving part's outline in the first view, where it is a knob with spokes.
        lever: The moving part as a solid in the first view, where its outline tells that it is a lever.
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
    up: Array | None
    knob: KnobOutline | None = None
    lever: LeverShape | None = None

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
    joint_type: JointType | None = None,
    up: Array | None = UP,
    beside: Sequence[Array] = (),
    pushed: Sequence[Push] = (),
    known_to: float = KNOWN_TO,
    network: Network | None = None,
    seed: int = 0,
) -> JointEstimate:
    """Estimate type, axis and motion of the one part that moved.

    Args:
        before: First view.
        after: Second view, in the same frame; the camera may stand elsewhere if its pose is known.
        region: Box (xmin, xmax, ymin, ymax, zmin, zmax) [m] in which to look for motion.
        ignore_mask_before: Pixels (h, w) of the first view to forget, e.g. the robot.
        ignore_mask_after: The same for the second view.
        joint_type: Consider only this family (a user who knows it is a drawer may say so).
        up: Unit vector against gravity in the frame of the views, None if unknown: most hinges are upright or level.
        beside: Directions (3,) in which parts beside this one slide: drawers of one chest slide alike.
        pushed: Where and which way the part was pushed between the views, as far as all of that is known: it did not go
            against every one of them.
        known_to: Answer with a turn only where half its 90 % interval is no more than this share of it.
        network: Weighs the hypotheses as well (`pair_network.PairNetworkRuntime`); views without a camera's pose have
            none.
        seed: Of the sampling.

    Raises:
        AbstainError: The views do not determine one joint; the text says why and what to do.
        BadViewError: The views are no usable pair.
    """
    rng = np.random.default_rng(seed)
    scene, warnings = prepare(before, after, region, ignore_mask_before, ignore_mask_after, rng)
    belief = None if network is None else network.belief(scene, np.random.default_rng([seed, 1]))
    scene, found = look_for_motion(scene, rng, joint_type=joint_type, up=up, beside=beside)
    if belief is not None:
        found = weighed(found, belief, scene, joint_type, np.random.default_rng([seed, 2]))
        known_to = sure_enough(known_to, found, belief)
    return conclude(found, scene, warnings, rng, up=up, pushed=pushed, known_to=known_to)


def look_for_motion(
    scene: Scene,
    rng: np.random.Generator,
    *,
    joint_type: JointType | None = None,
    up: Array | None = UP,
    beside: Sequence[Array] = (),
) -> tuple[Scene, Search]:
    """The first half of `estimate_joint`: the scene with its revealed level, and the refined candidates.

    Raises:
        NothingMovedError: Hardly anything changed between the views.
    """
    require_motion(scene)
    scene = with_revealed_level(scene, up, rng)
    return scene, search(scene, rng, joint_type=joint_type, up=up, beside=beside)


def conclude(
    found: Search,
    scene: Scene,
    warnings: list[str],
    rng: np.random.Generator,
    *,
    up: Array | None = UP,
    pushed: Sequence[Push] = (),
    known_to: float = KNOWN_TO,
) -> JointEstimate:
    """The second half of `estimate_joint`: the best candidate with its parts and intervals.

    Raises:
        AbstainError: The candidates do not determine one joint.
    """
    view_a, view_b, changes = scene.before, scene.after, scene.changes
    if not found.ranked:
        check_same_camera(view_a, view_b, changes, np.ones(len(view_a.points), dtype=bool), rng)
        raise AbstainError(
            "no single joint motion carries the first view onto the second; is the part rigid?"
        )
    fine = probe(view_a, scene.moved_before(), 1000, rng), probe(view_b, scene.moved_after(), 1000, rng)
    ranked, wishes = _one_way(found, scene, fine, pushed, rng), found.wishes
    best = ranked[0]
    parts = segment(scene, best.motion)
    explained = explained_by(best.refined, scene, rng)
    check_same_camera(view_a, view_b, changes, ~parts.before, rng)
    check_second_part(best.motion, found.motions, scene, sides(scene, rng), fine, rng)
    warnings = warnings + judge(ranked, scene, parts, explained, wishes.thin)
    centre = view_a.points[parts.before].mean(axis=0) if parts.before.any() else best.motion.origin
    few = explained.judged < EDGE_ON_JUDGED or best.refined.used < EDGE_ON_USED
    edge_on = not scene.small() and few and best.motion.joint_type == "revolute"
    if edge_on:
        warnings.append(
            "one of the views shows little but the edge of the part, so the hinge is less certain"
        )
    intervals = intervals90([(h.refined, h.weight) for h in ranked], centre, wishes.thin, edge_on)
    require_narrow(intervals, best.motion, known_to)
    require_standing(best.motion, parts, scene, up)
    motion = best.motion
    lever = _outlined(motion, scene, parts) if wishes.thin else None
    if lever is not None:
        half = Z90 * lever.turn_sigma
        motion = lever.hinge.positive()
        intervals = replace(intervals, delta=(motion.delta - half, motion.delta + half))
    motion = _with_origin_near(motion, centre)
    logger.info(
        "joint %s, delta %.4f, residual %.2f mm, cost %.3f of %d hypotheses",
        motion.joint_type, motion.delta, best.refined.residual_m * 1e3, best.cost, len(ranked),
    )  # fmt: skip
    return JointEstimate(
        motion.joint_type, motion.origin, motion.direction, motion.delta,
        "rad" if motion.joint_type == "revolute" else "m",
        intervals, best.refined.residual_m, view_a, view_b, parts, tuple(ranked), explained.share,
        tuple(warnings), up, lever=None if lever is None else lever.shape,
    )  # fmt: skip


def _outlined(motion: JointMotion, scene: Scene, parts: Parts) -> LeverOutline | None:
    """The part as a lever whose outline in colour tells its hinge and turn sharper than depth; None if it does not."""
    before, after = scene.before, scene.after
    if (
        motion.joint_type == "prismatic"
        or not isinstance(before, DepthView)
        or not isinstance(after, DepthView)
    ):
        return None
    return lever_outline(before, parts.before, after, parts.after, motion)


def weighed(
    found: Search, belief: Belief, scene: Scene, joint_type: JointType | None, rng: np.random.Generator
) -> Search:
    """The candidates in the order that evidence and a network's belief give them together.

    Where the network finds the best of them unlikely, its own motion is refined and joins them.
    """
    ranked = found.ranked
    if ranked and belief.nats(ranked[0].motion) < belief.unlikely_nats:
        own = [m for m in belief.motions() if joint_type in (None, m.joint_type)]
        ranked = rank([*own, *(h.motion for h in ranked[:AGAIN])], scene, found.wishes, rng)
    return replace(found, ranked=weighed_by(belief, ranked))


def sure_enough(known_to: float, found: Search, belief: Belief) -> float:
    """``known_to`` of `estimate_joint`, looser where a network agrees with the best candidate.

    Two ways that err differently came to the same motion: the interval, which is geometry's alone, is too wide then.
    """
    agrees = bool(found.ranked) and belief.nats(found.ranked[0].motion) >= AGREES_NATS
    return max(known_to, KNOWN_TO_BOTH) if agrees else known_to


def _one_way(
    found: Search, scene: Scene, probes: tuple[Probe, Probe], pushed: Sequence[Push], rng: np.random.Generator
) -> list[Hypothesis]:
    """The hypotheses, best first, without what goes against the pushes; equal spokes leave open which way they went.

    Raises:
        AbstainError: Two turns explain the views alike and no push tells them apart, or all motions go against them.
    """

    def agrees(motion: JointMotion) -> bool:
        return not pushed or any(push.agrees(motion) for push in pushed)

    ranked = found.ranked
    best = ranked[0].motion
    count = spokes(best, scene, probes)
    other = other_turn(best, count)
    if other is not None:
        if agrees(best) and agrees(other):
            refuse_two_turns(best, other, count)
        if not agrees(best):
            ranked = rank([other], scene, found.wishes, rng)
    ranked = [h for h in ranked if agrees(h.motion)]
    if not ranked:
        raise AbstainError(
            "every motion that explains the views goes against what was pushed between them; did something else move?"
        )
    return ranked


def prepare(
    before: DepthFrame | Cloud,
    after: DepthFrame | Cloud,
    region: Region | None,
    ignore_before: Mask | None,
    ignore_after: Mask | None,
    rng: np.random.Generator,
) -> tuple[Scene, list[str]]:
    """Both views with their change labels, and warnings.

    Raises:
        BadViewError: The views are no usable pair.
    """
    view_a, view_b, warnings = _views(before, after, ignore_before, ignore_after, rng)
    check_pair(view_a, view_b)
    where = _in_region(view_a, region), _in_region(view_b, region)
    if not (where[0].any() or where[1].any()):
        raise BadViewError(_outside((view_a, view_b), region))
    changes = compare(view_a, view_b)
    scene = Scene(view_a, view_b, without_specks(view_a, view_b, changes), *where)
    if area_of_motion(scene) < LEAST_MOVED_M2:
        changes = with_shadows(view_a, view_b, changes)
        scene = Scene(view_a, view_b, without_specks(view_a, view_b, changes), *where)
    return scene, warnings


@dataclass(frozen=True, eq=False)
class Search:
    """Candidates for one motion: refined ones in order of belief, all that were scanned, and what was wished for."""

    ranked: list[Hypothesis]
    motions: list[JointMotion]
    wishes: Wishes


def search(
    scene: Scene,
    rng: np.random.Generator,
    *,
    joint_type: JointType | None = None,
    up: Array | None = UP,
    beside: Sequence[Array] = (),
) -> Search:
    """Look for the motion that explains most of what moved; see `estimate_joint` for the options."""
    # Nearest neighbours in a bare cloud cost ten times a projection.
    few = 300 if isinstance(scene.before, DepthView) and isinstance(scene.after, DepthView) else 100
    probes = (
        probe(scene.before, scene.moved_before(), few, rng),
        probe(scene.after, scene.moved_after(), few, rng),
    )
    shape = hyp.structure(scene, rng, up)
    found = [*hyp.slides_beside(shape, beside), *hyp.axes(shape)]
    if joint_type is not None:
        found = [axis for axis in found if axis.joint_type == joint_type]
    motions, cost = hyp.scan(found, scene, *probes)
    anchors = np.concatenate([probes[0].points[:100], probes[1].points[:100]])
    starts = [motion for motion, _ in hyp.best_distinct(motions, cost, anchors, REFINED_HYPOTHESES)]
    wishes = Wishes(shape.fronts(), up, *shape.levers, columns=tuple(shape.columns), beside=tuple(beside))
    near = sampled(starts, shape.columns, scene, rng) if scene.small() and joint_type != "prismatic" else []
    ranked = rank(starts, scene, wishes, rng, near=near)
    turns = bool(ranked) and ranked[0].motion.joint_type == "revolute"
    if wishes.thin and turns and _carries(ranked[0], scene, rng):
        wishes = _of_whole_lever(ranked[0].motion, scene, wishes)
        ranked = rank([h.motion for h in ranked[:AGAIN]], scene, wishes, rng)
    return Search(ranked, motions, wishes)


def _carries(best: Hypothesis, scene: Scene, rng: np.random.Generator) -> bool:
    """Whether a motion is good enough to tell which points are the part's."""
    return explained_by(best.refined, scene, rng).share > LEAST_CARRIED


def _of_whole_lever(motion: JointMotion, scene: Scene, wishes: Wishes) -> Wishes:
    """Wishes with the lines of the whole lever: of what surely moved, the way it went has cut off a slanted piece."""
    parts = segment(scene, motion)
    lines = []
    for view, part, known in (
        (scene.before, parts.before, wishes.before),
        (scene.after, parts.after, wishes.after),
    ):
        p = view.points[part]
        p = p[line_distance(motion.origin, motion.direction, p) > HUB_M] if len(p) else p
        lines.append(line_within(p, view) or known)
    return replace(wishes, before=lines[0], after=lines[1])


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


def _outside(views: tuple[View, View], region: Region | None) -> str:
    p = np.concatenate([view.points for view in views])
    spans = ", ".join(f"{n} {a:.2f} to {b:.2f}" for n, a, b in zip("xyz", p.min(0), p.max(0), strict=True))
    box = ",".join(f"{x:g}" for x in region or ())
    return (
        f"no point of either view lies in the region {box}; the views span {spans} m: is it in their frame?"
    )


def _with_origin_near(motion: JointMotion, centre: Array) -> JointMotion:
    """Slide the origin along the axis to the part (hinge), or put it at the part's centre (slide)."""
    if motion.joint_type == "prismatic":
        return replace(motion, origin=centre)
    along = (centre - motion.origin) @ motion.direction
    return replace(motion, origin=motion.origin + along * motion.direction)


def _as_image(view: View, mask: Mask) -> Mask:
    return view.image(mask).astype(bool) if isinstance(view, DepthView) else mask
