"""What the pair network says per point, and the one joint that follows from it.

Each point votes for both families, as in Ditto (Jiang et al., CVPR 2022, "Building Digital Twins of Articulated Objects
from Interaction"): for a hinge its direction, the way from the point to its line, and the angle; for a slide its
direction and the distance. Votes come with the size of the error that the network expects of them, and each point says
as well where the motion takes it (its flow, whatever the family). Directions carry the sense of the motion from the
first view to the second, so that angle and distance are positive. Votes are joined by geometric medians instead of
Ditto's means: some points always belong to something else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.motion import JointMotion, line_distance
from s2r_host.perception.pair_cloud import PairCloud

Array = NDArray[np.floating]

# Columns of the network's output per point: logits, then votes in rad and dm.
PART, SLIDES = 0, 1
TURN_DIRECTION, TURN_OFFSET, TURN_ANGLE = slice(2, 5), slice(5, 8), 8
SLIDE_DIRECTION, SLIDE_DISTANCE = slice(9, 12), 12
FLOW = slice(13, 16)  # from its view into the other one [dm]
# Logarithms of the expected errors of direction [1], line [dm], state [rad or dm] and flow [dm].
SPREAD_DIRECTION, SPREAD_LINE, SPREAD_STATE, SPREAD_FLOW = range(16, 20)
VOTES = 20

FEWEST = 24  # points that are believed to belong to the part; fewer say nothing
STEPS = 12  # of Weiszfeld's iteration
LEAST_TURN_RAD, LEAST_SLIDE_M = np.radians(1.0), 0.002


class Opinion(NamedTuple):
    """What the votes come to.

    Attributes:
        turn, slide: Best motion of either family, frame of the views [m, rad].
        slides: Probability that it is the slide.
        expected: Errors that the votes expect of themselves, of direction [1], line [m], state [rad or m] and flow
            [m], medians over the part's points, shape (4,).
        part: Probability per point that it belongs to the part, shape of the points without their last axis.
    """

    turn: JointMotion
    slide: JointMotion
    slides: float
    expected: Array
    part: Array

    def best(self) -> JointMotion:
        """The likelier of the two."""
        return self.slide if self.slides > 0.5 else self.turn


@dataclass(frozen=True, eq=False)
class Votes:
    """Votes of points.

    Attributes:
        points: [m], frame of the views, shape (n, 3).
        output: Columns as above, directions and offsets in the frame of the views, shape (n, `VOTES`).
        second: Which of them are points of the second view, shape (n,).
    """

    points: Array
    output: Array
    second: NDArray[np.bool_]

    @staticmethod
    def of(cloud: PairCloud, output: Array, R: Array) -> Votes:
        """What the network put out, (2, P, `VOTES`), for a cloud that was turned by R (3, 3)."""
        flat = output.reshape(-1, output.shape[-1])
        second = np.repeat([False, True], len(cloud.points[0]))
        return Votes(cloud.points.reshape(-1, 3), turned_back(flat, R), second)

    @staticmethod
    def joined(some: list[Votes]) -> Votes:
        """Votes of several passes as one poll."""
        return Votes(
            np.concatenate([v.points for v in some]),
            np.concatenate([v.output for v in some]),
            np.concatenate([v.second for v in some]),
        )

    def opinion(self) -> Opinion | None:
        """The joint most points vote for; None if hardly any of them is believed to belong to a moving part."""
        part = 1.0 / (1.0 + np.exp(-self.output[:, PART].astype(float)))
        mine = part > 0.5
        if np.count_nonzero(mine) < FEWEST:
            return None
        p, vote, weight = self.points[mine], self.output[mine].astype(float), part[mine]
        slides = float(1.0 / (1.0 + np.exp(-np.average(vote[:, SLIDES], weights=weight))))
        turn_direction = _direction(vote[:, TURN_DIRECTION], weight)
        slide_direction = _direction(vote[:, SLIDE_DIRECTION], weight)
        # Feet of points that agree lie along the line; seen along it they coincide.
        feet = p + 0.1 * vote[:, TURN_OFFSET]
        feet -= ((feet - p.mean(axis=0)) @ turn_direction)[:, None] * turn_direction
        turn = JointMotion(
            "revolute",
            geometric_median(feet, weight),
            turn_direction,
            max(median(vote[:, TURN_ANGLE], weight), LEAST_TURN_RAD),
        )
        slide = JointMotion(
            "prismatic",
            p.mean(axis=0),
            slide_direction,
            max(0.1 * median(vote[:, SLIDE_DISTANCE], weight), LEAST_SLIDE_M),
        )
        told = np.exp(vote[:, SPREAD_DIRECTION : SPREAD_FLOW + 1])
        expected = np.array([median(column, weight) for column in told.T])
        expected *= [1.0, 0.1, 0.1 if slides > 0.5 else 1.0, 0.1]
        return Opinion(turn, slide, slides, expected, part)

    def where(self) -> tuple[Array, Array, Array]:
        """What the flow says: points of the part in the first view, the same in the second [m] (n, 3), belief (n,)."""
        part = 1.0 / (1.0 + np.exp(-self.output[:, PART].astype(float)))
        mine = part > 0.5
        p, there = self.points[mine], self.points[mine] + 0.1 * self.output[mine, FLOW]
        second = self.second[mine, None]
        return np.where(second, there, p), np.where(second, p, there), part[mine]


def true_votes(points: Array, motion: JointMotion, back: bool = False) -> NDArray[np.float32]:
    """What every point of the part should vote, shape (n, `VOTES`); columns of the other family are 0.

    Args:
        points: In either view [m], shape (n, 3): the line of a hinge stays where it is.
        motion: With delta >= 0.
        back: The points are those of the second view, whose flow leads into the first.
    """
    vote = np.zeros((len(points), VOTES), np.float32)
    vote[:, FLOW] = 10 * flow(points, motion, back)
    if motion.joint_type == "prismatic":
        vote[:, SLIDES] = 1.0
        vote[:, SLIDE_DIRECTION] = motion.direction
        vote[:, SLIDE_DISTANCE] = 10 * motion.delta
    else:
        gap = motion.origin - points
        vote[:, TURN_DIRECTION] = motion.direction
        vote[:, TURN_OFFSET] = 10 * (gap - (gap @ motion.direction)[:, None] * motion.direction)
        vote[:, TURN_ANGLE] = motion.delta
    return vote


def flow(points: Array, motion: JointMotion, back: bool) -> Array:
    """Where a motion takes points of one view in the other [m] (n, 3), as a way from where they are."""
    X = motion.transform()
    if back:
        X = np.linalg.inv(X)
    return points @ (X[:3, :3] - np.eye(3)).T + X[:3, 3]


def turned_back(output: Array, R: Array) -> Array:
    """Votes (n, `VOTES`) of a cloud that was turned by R (3, 3), in the frame of the views."""
    output = np.array(output, dtype=float)
    for column in (TURN_DIRECTION, TURN_OFFSET, SLIDE_DIRECTION, FLOW):
        output[:, column] = output[:, column] @ R
    return output


def geometric_median(x: Array, weight: Array) -> Array:
    """The point with the least weighted sum of distances to rows of x (n, d), by Weiszfeld's iteration, shape (d,)."""
    middle = np.average(x, axis=0, weights=weight)
    for _ in range(STEPS):
        near = weight / np.maximum(np.linalg.norm(x - middle, axis=1), 1e-4)
        middle = np.average(x, axis=0, weights=near)
    return middle


def _direction(vote: Array, weight: Array) -> Array:
    middle = geometric_median(vote, weight)
    length = np.linalg.norm(middle)
    return middle / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])


def median(value: Array, weight: Array) -> float:
    """Weighted median of values (n,)."""
    order = np.argsort(value, kind="stable")
    share = np.cumsum(weight[order])
    return float(value[order][np.searchsorted(share, 0.5 * share[-1])])


def errors(found: JointMotion, truth: JointMotion, beside: Array) -> tuple[float, float, float]:
    """Angle of the directions [rad], sense included, distance of the lines [m] beside a point (3,), error of delta."""
    angle = float(np.arccos(np.clip(found.direction @ truth.direction, -1, 1)))
    foot = truth.origin + ((beside - truth.origin) @ truth.direction) * truth.direction
    line = float(line_distance(found.origin, found.direction, foot[None])[0])
    return angle, line, found.delta - truth.delta
