"""Is this posture free? Is the way between two postures free? And if not: what touches what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.obstacles import Obstacle
from s2r_protocol.arms.clearance import LINKS_APART_M

LARGEST_STEP_M = 0.01


@dataclass(frozen=True)
class Clearance:
    """Distances to keep [m]. ``tip_m`` is the fingertip's, None when it is allowed to touch.

    ``self_m`` is a little more than admission asks for: what is nearer would be refused when it is sent.
    """

    obstacle_m: float = 0.015
    table_m: float = 0.01
    self_m: float = LINKS_APART_M + 5e-4
    tip_m: float | None = 0.01


class CollisionChecker:
    """The arm against itself and a fixed set of obstacles, each pair with its own clearance."""

    def __init__(
        self, arm: ArmModel, obstacles: Sequence[Obstacle], clearance: Clearance | None = None
    ) -> None:
        clearance = clearance or Clearance()
        self.arm = arm
        self._geometry: pin.GeometryModel = arm.shapes.copy()
        self._names = [f"{arm.link_of(i)}" for i in range(arm.shapes.ngeoms)]
        self._margins: list[float] = []
        self._where: dict[str, int] = {}
        self._home: dict[str, pin.SE3] = {}
        self._pair_self(clearance.self_m)
        for obstacle in obstacles:
            self._add(obstacle, clearance)
        self._data = self._geometry.createData()
        for request, margin in zip(self._data.collisionRequests, self._margins, strict=True):
            request.security_margin = margin

    def _pair_self(self, margin_m: float) -> None:
        excluded = {frozenset(pair) for pair in self.arm.arm.collision_exclude}
        count = self.arm.shapes.ngeoms
        for i in range(count):
            for j in range(i + 1, count):
                links = (self._names[i], self._names[j])
                if links[0] != links[1] and frozenset(links) not in excluded:
                    self._pair(i, j, margin_m)

    def _add(self, obstacle: Obstacle, clearance: Clearance) -> None:
        pose = pin.SE3(obstacle.X_base_shape[:3, :3], obstacle.X_base_shape[:3, 3])
        index = self._geometry.addGeometryObject(
            pin.GeometryObject(obstacle.name, 0, 0, pose, obstacle.geometry)
        )
        self._names.append(obstacle.name)
        self._where[obstacle.name] = index
        self._home[obstacle.name] = pose
        is_table = obstacle.name == "table"
        source = self.arm.arm.source
        never_against_table = source.standing | {source.joints[0].child}
        for i in range(self.arm.shapes.ngeoms):
            if is_table and self._names[i] in never_against_table:
                continue
            margin = clearance.table_m if is_table else clearance.obstacle_m
            if i in self.arm.tip_shapes and not is_table:
                if clearance.tip_m is None:
                    continue
                margin = clearance.tip_m
            self._pair(i, index, margin)

    def _pair(self, i: int, j: int, margin_m: float) -> None:
        self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._margins.append(margin_m)

    def place(self, name: str, p_shift: np.ndarray) -> None:
        """Shift an obstacle by a vector [m], shape (3,), from where it was given."""
        home = self._home[name]
        self._geometry.geometryObjects[self._where[name]].placement = pin.SE3(
            home.rotation, home.translation + np.asarray(p_shift, float)
        )

    def is_free(self, q: np.ndarray) -> bool:
        """Whether every pair keeps its clearance at q."""
        return not pin.computeCollisions(self.arm.model, self.arm.data, self._geometry, self._data, q, True)

    def touching(self, q: np.ndarray) -> str | None:
        """One sentence naming the first pair too close at q, or None."""
        if self.is_free(q):
            return None
        for pair, result in zip(self._geometry.collisionPairs, self._data.collisionResults, strict=True):
            if result.isCollision():
                return f"{self._names[pair.first]} against {self._names[pair.second]}"
        return "unknown pair"

    def hand_touching(self, X_base_tool: np.ndarray) -> str | None:
        """What the hand alone would touch with the tool frame at a pose (4, 4), whatever the arm behind it does."""
        X_base_wrist = pin.SE3(X_base_tool[:3, :3], X_base_tool[:3, 3]) * self.arm.X_wrist_tool.inverse()
        shapes = self._geometry.geometryObjects
        for pair, request in zip(self._geometry.collisionPairs, self._data.collisionRequests, strict=True):
            if pair.first not in self.arm.hand_shapes or pair.second < self.arm.shapes.ngeoms:
                continue
            hand, other = shapes[pair.first], shapes[pair.second]
            at_hand, at_other = X_base_wrist * hand.placement, other.placement
            result = coal.CollisionResult()
            coal.collide(
                hand.geometry,
                coal.Transform3s(at_hand.rotation, at_hand.translation),
                other.geometry,
                coal.Transform3s(at_other.rotation, at_other.translation),
                request,
                result,
            )
            if result.isCollision():
                return f"{self._names[pair.first]} against {self._names[pair.second]}"
        return None

    def line_is_free(self, q_from: np.ndarray, q_to: np.ndarray) -> bool:
        """Whether the straight joint-space line is free; no point of the arm moves over 1 cm between checks."""
        travel_m = float(np.abs(q_to - q_from) @ self.arm.lever_m)
        count = max(1, int(np.ceil(travel_m / LARGEST_STEP_M)))
        return all(self.is_free(q_from + (q_to - q_from) * k / count) for k in _middle_first(count))

    def path_is_free(self, q_path: np.ndarray) -> bool:
        """Whether a polyline of shape (n, dof) is free, its first point included."""
        if not self.is_free(q_path[0]):
            return False
        return all(self.line_is_free(a, b) for a, b in pairwise(q_path))


def _middle_first(count: int) -> list[int]:
    """1..count, far apart first: collisions in the middle of a line are found early."""
    order = [count]
    stride = 1
    while stride < count:
        stride *= 2
    seen = {0, count}
    while stride > 1:
        stride //= 2
        for k in range(stride, count, stride):
            if k not in seen:
                seen.add(k)
                order.append(k)
    return order
