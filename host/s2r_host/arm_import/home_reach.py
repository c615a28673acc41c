"""How much of where objects stand an arm reaches from its home pose."""

from __future__ import annotations

from collections import Counter
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
    """How many of ``asked`` poses at objects are reached: at all, on the straight way, and with room between links.

    ``blocked`` are two links that are too near to each other in more of the others than are reached.
    """

    asked: int
    reached: int
    straight: int
    roomy: int
    blocked: tuple[str, str] | None = None


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
        found = [self._posture(p, tilt, q) for p, tilt in self._goals]
        goals = [goal for goal in found if isinstance(goal, np.ndarray)]
        touching = Counter(goal for goal in found if isinstance(goal, str) and "table" not in goal)
        text, count = max(touching.items(), key=lambda item: item[1], default=("", 0))
        first, _, second = text.partition(" against ")
        return Reached(
            asked=len(found),
            reached=len(goals),
            straight=sum(self._free.line_is_free(q, goal) for goal in goals),
            roomy=sum(map(self._roomy.is_free, goals)),
            blocked=(first, second) if count > len(goals) else None,
        )

    def _posture(self, p: np.ndarray, tilt: float, q: np.ndarray) -> np.ndarray | str | None:
        """A free posture near ``q`` with the fingertip at ``p`` (3,) [m], tilted down from the way there.

        What touches what where none is free, None where there is no posture.
        """
        X, touching = np.eye(4), None
        X[:3, 3] = p
        for roll in _ROLLS_RAD:
            X[:3, :3] = tool_orientation(np.array([1.0, 0.0, 0.0]), tilt, float(np.arctan2(p[1], p[0])), roll)
            goal = self._ik.solve(X, q)
            if goal is None:
                continue
            pair = self._free.touching(goal)
            if pair is None:
                return goal
            touching = touching or pair
        return touching
