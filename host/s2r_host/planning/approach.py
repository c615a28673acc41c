"""A free way for the whole arm from where it is to a place at the part, before any physics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.errors import NoMotionError
from s2r_host.motion.joint_motion import plan_joint_motion
from s2r_host.planning.free_space import FINE_STEP_RAD, STEP_RAD, FreeSpace
from s2r_host.planning.scene import Scene
from s2r_protocol.arms import ArmDescription

_NODES = 500


@dataclass(frozen=True, eq=False)
class _Limits:
    """What the path search asks about the arm."""

    arm: ArmDescription
    q_min: np.ndarray
    q_max: np.ndarray

    def inside_limits(self, q: np.ndarray) -> bool:
        """Whether a posture is within them."""
        return bool((q >= self.q_min).all() and (q <= self.q_max).all())


class _Checker:
    """The free space at one state of the object, as the path search wants to ask about it."""

    def __init__(self, scene: Scene, space: FreeSpace, s: float, step_rad: float) -> None:
        self.arm = _Limits(scene.arm, scene.arm.limits.q_min, scene.arm.limits.q_max)
        self._space, self._s, self._step_rad = space, s, step_rad

    def touching(self, q: np.ndarray) -> str | None:
        """What touches what at a posture, or None."""
        return "something" if self._space.touches(q[None], self._s)[0] else None

    def line_is_free(self, q_from: np.ndarray, q_to: np.ndarray) -> bool:
        """Whether the straight joint-space line is free."""
        return self._space.path_is_free(np.array([q_from, q_to]), self._s, self._step_rad)

    def path_is_free(self, q_path: np.ndarray) -> bool:
        """Whether a polyline (n, dof) is free."""
        return self._space.path_is_free(q_path, self._s, self._step_rad)


def find_approach(
    scene: Scene, space: FreeSpace, q_start: np.ndarray, q_goal: np.ndarray, s: float
) -> np.ndarray | None:
    """A collision-free joint path (n, dof) around the object at joint value s, or None; the same on every call."""
    for step_rad in (STEP_RAD, FINE_STEP_RAD):
        try:
            way = plan_joint_motion(
                _Checker(scene, space, s, step_rad),
                q_start,
                q_goal,
                np.random.default_rng(0),
                _NODES,
                "approach",
            )
        except NoMotionError:
            return None
        if space.path_is_free(way, s, FINE_STEP_RAD):
            return way
    return None
