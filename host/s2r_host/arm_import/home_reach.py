"""How much of where objects stand an arm reaches from its home pose."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from s2r_host.arm_import.home_asked import Place
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.inverse import InverseKinematics
from s2r_host.motion.obstacles import table_obstacle
from s2r_host.motion.push_proposals import tool_orientation

_AHEAD, _ASIDE, _HIGH = (0.95, 1.15), (-0.17, 0.17), (0.2, 0.4)  # of the distance at which objects stand
_TILTS_RAD = (1.9, 1.3, 0.6)  # pulling from behind, pushing steeply and flatly
_ROOMY_M = 0.03
_ROLLS_RAD = (0.0, 0.5 * np.pi)


@dataclass(frozen=True)
class Reached:
    """How many of ``asked`` poses at objects are reached: at all, on the straight way, and with room between links."""

    asked: int
    reached: int
    straight: int
    roomy: int


class Reach:
    """Poses at objects, before, above and behind them, and which of them an arm gets to from where."""

    def __init__(self, arm: ArmModel, place: Place) -> None:
        self._ik = InverseKinematics(arm)
        self._free = CollisionChecker(arm, (table_obstacle(),))
        self._roomy = CollisionChecker(arm, (table_obstacle(),), Clearance(self_m=_ROOMY_M))
        self._goals = [
            (place.object_m * np.array(p), tilt)
            for p, tilt in product(product(_AHEAD, _ASIDE, _HIGH), _TILTS_RAD)
        ]

    def from_pose(self, q: np.ndarray) -> Reached:
        """What is reached from a pose (dof,) [rad]."""
        goals = [goal for p, tilt in self._goals if (goal := self._posture(p, tilt, q)) is not None]
        straight = sum(self._free.line_is_free(q, goal) for goal in goals)
        return Reached(len(self._goals), len(goals), straight, sum(map(self._roomy.is_free, goals)))

    def _posture(self, p: np.ndarray, tilt: float, q: np.ndarray) -> np.ndarray | None:
        """A free posture near ``q`` with the fingertip at ``p`` (3,) [m], tilted down from the way there."""
        X = np.eye(4)
        X[:3, 3] = p
        for roll in _ROLLS_RAD:
            X[:3, :3] = tool_orientation(np.array([1.0, 0.0, 0.0]), tilt, float(np.arctan2(p[1], p[0])), roll)
            goal = self._ik.solve(X, q)
            if goal is not None and self._free.is_free(goal):
                return goal
        return None
