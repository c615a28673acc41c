"""Which obstacle the fingertip is nearest to: the surface a push acts on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.obstacles import Obstacle


@dataclass(frozen=True, eq=False)
class Nearest:
    """The obstacle nearest to the fingertip.

    Attributes:
        name: Of the obstacle.
        distance_m: Negative inside.
        p: Its point nearest to the fingertip, base frame, (3,) [m].
    """

    name: str
    distance_m: float
    p: np.ndarray


def nearest_to_tip(arm: ArmModel, q: np.ndarray, obstacles: Sequence[Obstacle]) -> Nearest:
    """Which of the obstacles is nearest to the fingertip at q (dof,) [rad], and where."""
    placements = arm.shape_placements(q)
    best = Nearest("", float("inf"), np.full(3, np.nan))
    for obstacle in obstacles:
        X = obstacle.X_base_shape
        there = coal.Transform3s(X[:3, :3], X[:3, 3])
        for i in arm.tip_shapes:
            here = coal.Transform3s(placements[i].rotation, placements[i].translation)
            shape, result = arm.shapes.geometryObjects[i].geometry, coal.DistanceResult()
            distance = coal.distance(shape, here, obstacle.geometry, there, coal.DistanceRequest(), result)
            if distance < best.distance_m:
                best = Nearest(obstacle.name, float(distance), np.array(result.getNearestPoint2()).ravel())
    return best
