"""Which obstacle the fingertip is nearest to: the surface a push acts on."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.obstacles import Obstacle


def nearest_to_tip(arm: ArmModel, q: np.ndarray, obstacles: Sequence[Obstacle]) -> tuple[str, float]:
    """Name of the obstacle nearest to the fingertip at q, and its distance [m] (negative inside)."""
    placements = arm.shape_placements(q)
    best = ("", float("inf"))
    for obstacle in obstacles:
        X = obstacle.X_base_shape
        there = coal.Transform3s(X[:3, :3], X[:3, 3])
        for i in arm.tip_shapes:
            here = coal.Transform3s(placements[i].rotation, placements[i].translation)
            shape = arm.shapes.geometryObjects[i].geometry
            distance = coal.distance(
                shape, here, obstacle.geometry, there, coal.DistanceRequest(), coal.DistanceResult()
            )
            if distance < best[1]:
                best = (obstacle.name, float(distance))
    return best
