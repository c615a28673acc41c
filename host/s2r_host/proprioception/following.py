"""Where the part was while the fingertip pushed it: where its surface meets the fingertip.

The part is known as it was seen and built; the fingertip by the arm's joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import coal
import numpy as np
from scipy.optimize import brentq

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.obstacles import Obstacle
from s2r_host.proprioception.samples import Samples

TOUCH = 1e-6  # joint values are found this closely [m or rad]
STEPS = 60
CLEAR_M, EVERY_ROWS = 0.01, 4  # nearer than this a fingertip may touch: the part is known to millimetres
NEAR = 0.02  # of the search range: as far as a part goes between two rows


@dataclass(frozen=True, eq=False)
class PushedPart:
    """The part as a fingertip meets it.

    Attributes:
        shapes: Its pieces at joint value 0, base frame.
        pose: X (4, 4) of the part at a joint value, base frame.
        velocity: Motion of points (n, 3) of the part per unit of the joint, (n, 3).
        positive: The joint grows when it is pushed.
    """

    shapes: Sequence[Obstacle]
    pose: Callable[[float], np.ndarray]
    velocity: Callable[[np.ndarray], np.ndarray]
    positive: bool

    @property
    def turning(self) -> np.ndarray:
        """Turn of the part per unit of the joint, base frame, (3,): zero for a slide."""
        still, x, y, z = self.velocity(np.concatenate([np.zeros((1, 3)), np.eye(3)]))
        return np.array([(y - still)[2], (z - still)[0], (x - still)[1]])


def free_rows(arm: ArmModel, samples: Samples, part: PushedPart, s: float) -> int:
    """How many rows at the beginning of a motion pass before the fingertip comes near the part, still at ``s``."""
    for row in range(0, len(samples), EVERY_ROWS):
        if _Apart(arm, samples.q[row], part)(s) < CLEAR_M:
            return max(0, row - EVERY_ROWS)
    return len(samples)


@dataclass(frozen=True, eq=False)
class Followed:
    """The part during some rows of a motion.

    Attributes:
        rows: Consecutive, (n,).
        s: Joint values at which the part just touches the fingertip [m or rad], (n,).
        p: Where [m], base frame, (n, 3).
    """

    rows: np.ndarray
    s: np.ndarray
    p: np.ndarray


def follow(
    arm: ArmModel,
    samples: Samples,
    rows: np.ndarray,
    part: PushedPart,
    s_now: float,
    s_end: float,
    most: float,
) -> Followed | None:
    """The part over the longest stretch of the rows without a jump; None where some row touches nothing of it.

    A fingertip that was felt to push, where the part as known is out of its reach, pushed something else or a part that
    is not where it is believed: the other rows of the stretch are then believed no more than that one.

    The part is ahead of the fingertip; moved back towards it, it touches at some value and overlaps beyond. Another
    place of the part, the inside of a drawer's back for one, may do so too, at another value: the touch begins with
    the one nearest to ``s_now``, where the part was until then, and a fingertip that changes its place ends it.

    Args:
        arm: Its fingertip.
        samples: The motion.
        rows: Of it, (n,).
        part: What is pushed.
        s_now: Joint value until then [m or rad].
        s_end: After the motion.
        most: How far the joint may be from ``s_end`` at most.
    """
    back = -most if part.positive else most
    found: list[float] = []
    touched: list[np.ndarray] = []
    for row in samples.q[rows]:
        apart = _Apart(arm, row, part)
        near = found[-1] if found else None
        span = None if near is None else _bracket(apart, (near - NEAR * back, near + NEAR * back))
        if span is None:
            values = np.linspace(s_end - back, s_end + back, STEPS)
            spans = (_bracket(apart, (float(a), float(b))) for a, b in pairwise(values))
            expected = s_now if near is None else near
            span = min(
                (one for one in spans if one is not None),
                key=lambda one: abs(sum(one) / 2.0 - expected),
                default=None,
            )
        if span is None:
            return None
        found.append(float(brentq(apart, *span, xtol=TOUCH)))  # pyright: ignore[reportArgumentType]
        apart(found[-1])
        touched.append(apart.nearest)
    if not found:
        return None
    s = np.array(found)
    together = _unbroken(s, NEAR * most)
    return Followed(rows[together], s[together], np.array(touched)[together])


def _bracket(apart: Callable[[float], float], span: tuple[float, float]) -> tuple[float, float] | None:
    """The span if the fingertip is free at its first end and inside the part at its second."""
    return span if apart(span[0]) > 0.0 >= apart(span[1]) else None


class _Apart:
    """Distance of the fingertip from the part at a joint value [m], negative inside."""

    def __init__(self, arm: ArmModel, q: np.ndarray, part: PushedPart) -> None:
        placements = arm.shape_placements(q)
        self._tip = [
            (
                arm.shapes.geometryObjects[i].geometry,
                coal.Transform3s(placements[i].rotation, placements[i].translation),
            )
            for i in sorted(arm.tip_shapes)
        ]
        self._part = part
        self.nearest = np.zeros(3)  # on the fingertip, of the last call, base frame [m]

    def __call__(self, s: float) -> float:
        X, least = self._part.pose(s), np.inf
        for shape in self._part.shapes:
            there = X @ shape.X_base_shape
            placed = coal.Transform3s(there[:3, :3], there[:3, 3])
            for geometry, here in self._tip:
                result = coal.DistanceResult()
                distance = coal.distance(
                    geometry, here, shape.geometry, placed, coal.DistanceRequest(), result
                )
                if distance < least:
                    least, self.nearest = distance, np.array(result.getNearestPoint1()).ravel()
        return float(least)


def _unbroken(s: np.ndarray, step: float) -> np.ndarray:
    """Rows of the longest stretch of joint values (n,) without a jump: a fingertip has several places on a part."""
    breaks = np.flatnonzero(np.abs(np.diff(s)) > step) + 1
    return max(np.split(np.arange(len(s)), breaks), key=len)
