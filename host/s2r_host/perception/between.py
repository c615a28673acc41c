"""A joint refined by frames that were taken while the part moved.

Each frame makes two pairs, with the first view and with the last. All pairs share the axis and have a motion each;
their systems are solved together. What the depth of one view has wrong by itself, waves on a plate, a hand at its edge,
counts less the more views there are. Small parts gain nothing: the depth of a lever is smeared alike in every frame.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception import hypotheses as hyp
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.estimate import UP, JointEstimate, Region, prepare
from s2r_host.perception.evidence import Scene, probe, score
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import JointMotion, line_distance
from s2r_host.perception.refine import (
    CORRELATED_POINTS,
    LAST_GATE_M,
    LEAST_ROWS,
    LEAST_SPREAD_M,
    PLATE_M,
    THICKEST_M,
    Side,
    limited,
    linearised,
    perturbed,
    sides,
    wished,
)
from s2r_host.perception.revealed import with_revealed_level
from s2r_host.perception.segment import segment
from s2r_host.perception.verdict import require_motion
from s2r_host.perception.wishes import Wishes

logger = logging.getLogger(__name__)

Array = NDArray[np.floating]

ROUNDS, FIRST_GATE_M = 10, 0.012
STATES, PROBED = 26, 300  # tried for a frame, and points that they are judged by
MOST_STEP = 0.1  # of one pair's motion in a round [m or rad]
LEAST_RAD, LEAST_M = float(np.radians(3.0)), 0.006  # a pair with less motion tells nothing of an axis


@dataclass(frozen=True, eq=False)
class MovedPair:
    """Two views of one motion: what is compared, and how far the part went between them [m or rad]."""

    both: tuple[Side, Side]
    delta: float


def refined_between(
    estimate: JointEstimate,
    before: DepthFrame,
    after: DepthFrame,
    between: Sequence[DepthFrame],
    *,
    region: Region | None = None,
    up: Array | None = UP,
    seed: int = 0,
) -> JointEstimate:
    """The joint of two views, refined by frames from in between.

    The intervals stay as wide as two views leave them. An axis that would leave them is not believed: something else
    than the part moved in the frames.

    Args:
        estimate: The joint as told by ``before`` and ``after``.
        before, after: The two views.
        between: Frames while the part moved, in any order, hands and arms in them or not.
        region: In which to look for motion, as given for ``estimate``.
        up: Against gravity, as given for ``estimate``.
        seed: Of the sampling.

    Raises:
        BadViewError: A frame is no usable pair with the two views.
    """
    rng = np.random.default_rng([seed, 3])
    whole = with_revealed_level(prepare(before, after, region, None, None, rng)[0], up, rng)
    if whole.small():
        return _with_note(estimate, "frames between were not used: the part is too small to gain by them")
    ends = [MovedPair(sides(whole, rng), estimate.delta)]
    pairs = _pairs(estimate.motion, before, after, between, region, up, rng)
    if not pairs:
        return _with_note(estimate, "frames between were not used: they show no motion")
    shape = hyp.structure(whole, rng, up)
    wishes = Wishes(shape.fronts(), up, *shape.levers, columns=tuple(shape.columns))
    motion = refine_together(estimate.motion, ends + pairs, wishes)
    problem = _apart(estimate, motion)
    if problem is not None:
        return _with_note(estimate, f"frames between were not used: {problem}")
    logger.info(
        "%d pairs with frames between: %.4f instead of %.4f", len(pairs), motion.delta, estimate.delta
    )
    parts = segment(whole, motion)
    centre = whole.before.points[parts.before].mean(axis=0) if parts.before.any() else estimate.axis_origin_m
    origin = centre
    if motion.joint_type == "revolute":
        origin = motion.origin + ((centre - motion.origin) @ motion.direction) * motion.direction
    half = 0.5 * (estimate.intervals90.delta[1] - estimate.intervals90.delta[0])
    return replace(
        estimate,
        axis_origin_m=origin,
        axis_direction=motion.direction,
        delta=motion.delta,
        intervals90=replace(estimate.intervals90, delta=(motion.delta - half, motion.delta + half)),
        view_before=whole.before,
        view_after=whole.after,
        parts=parts,
    )


def _pairs(
    motion: JointMotion,
    before: DepthFrame,
    after: DepthFrame,
    between: Sequence[DepthFrame],
    region: Region | None,
    up: Array | None,
    rng: np.random.Generator,
) -> list[MovedPair]:
    """Every frame with either end, where the part moved between them."""
    found = []
    for frame in between:
        for first, second in ((before, frame), (frame, after)):
            scene, _ = prepare(first, second, region, None, None, rng)
            try:
                require_motion(scene)
            except AbstainError:
                continue  # at rest there, or nearly
            pair = moved_pair(with_revealed_level(scene, up, rng), motion, rng)
            if pair is not None:
                found.append(pair)
    return found


def moved_pair(scene: Scene, motion: JointMotion, rng: np.random.Generator) -> MovedPair | None:
    """How far the part went between two views on its way along a known motion; None where hardly at all."""
    moved = scene.moved_before(), scene.moved_after()
    if not (len(moved[0]) and len(moved[1])):
        return None
    delta = np.linspace(0.0, motion.delta, STATES)
    probes = (probe(scene.before, moved[0], PROBED, rng), probe(scene.after, moved[1], PROBED, rng))
    cost = score([replace(motion, delta=float(one)) for one in delta], scene, *probes, extra_m=0.001)
    best = float(delta[int(np.argmin(cost))])
    least = LEAST_M if motion.joint_type == "prismatic" else LEAST_RAD
    return MovedPair(sides(scene, rng), best) if best >= least else None


def refine_together(
    motion: JointMotion, pairs: Sequence[MovedPair], wishes: Wishes | None = None
) -> JointMotion:
    """The motion whose axis suits all pairs: Gauss-Newton with re-association in every round.

    Unknowns are the axis' two or four parameters and, per pair, its motion and the thickness of a plate.

    Args:
        motion: From the first view to the last, where to begin.
        pairs: The first of them is of those two views.
        wishes: What is known of joints beforehand.
    """
    axis = 2 if motion.joint_type == "prismatic" else 4
    delta, plate_m = np.array([pair.delta for pair in pairs]), np.full(len(pairs), PLATE_M)
    size = axis + 2 * len(pairs)
    for gate in np.geomspace(FIRST_GATE_M, LAST_GATE_M, ROUNDS):
        hessian, gradient, scales = np.zeros((size, size)), np.zeros(size), []
        for k, pair in enumerate(pairs):
            one = replace(motion, delta=float(delta[k]))
            rows = linearised(one, float(plate_m[k]), pair.both, float(gate))
            if rows.surface.sum() < LEAST_ROWS:
                continue
            scales.append(max(rows.scale_m(), LEAST_SPREAD_M))
            H, g = rows.normal_equations()
            H_plate, g_plate = wished(one, float(plate_m[k]), None, scales[-1])
            own = [*range(axis), axis + 2 * k, axis + 2 * k + 1]
            hessian[np.ix_(own, own)] += (H + H_plate) / scales[-1] ** 2
            gradient[own] += (g + g_plate) / scales[-1] ** 2
        if not scales:
            return motion
        if wishes is not None:
            scale = float(np.median(scales))
            H, g = wished(replace(motion, delta=float(delta[0])), PLATE_M, wishes, scale)
            hessian[:axis, :axis] += H[:axis, :axis] / scale**2
            gradient[:axis] += g[:axis] / scale**2
        damping = np.diag(1e-4 * np.diag(hessian) + 1.0 / CORRELATED_POINTS)
        step = -np.linalg.solve(hessian + damping, gradient)
        motion = perturbed(motion, limited(np.append(step[:axis], 0.0), motion))
        delta = delta + np.clip(step[axis::2], -MOST_STEP, MOST_STEP)
        plate_m = np.clip(plate_m + step[axis + 1 :: 2], 0.5 * plate_m, THICKEST_M)
    return replace(motion, delta=float(delta[0]))


def _apart(estimate: JointEstimate, motion: JointMotion) -> str | None:
    """Why a motion cannot be the one that two views told; None where it can."""
    interval = estimate.intervals90
    cosine = float(np.clip(motion.direction @ estimate.axis_direction, -1.0, 1.0))
    angle = float(np.arccos(cosine))
    if angle > interval.axis_angle_rad:
        return f"with them the axis turns by {np.degrees(angle):.1f}°, out of its 90 % interval"
    if motion.joint_type == "revolute":
        off_m = float(line_distance(motion.origin, motion.direction, estimate.axis_origin_m[None])[0])
        if off_m > interval.axis_offset_m:
            return f"with them the hinge moves by {1e3 * off_m:.1f} mm, out of its 90 % interval"
    return None


def _with_note(estimate: JointEstimate, text: str) -> JointEstimate:
    return replace(estimate, warnings=(*estimate.warnings, text))
