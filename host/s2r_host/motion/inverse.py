"""Inverse kinematics with pink: a quadratic programme per step, joint limits as constraints."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pink
import pinocchio as pin
from pink.limits import ConfigurationLimit
from pink.tasks import FrameTask, PostureTask

from s2r_host.motion.arm_model import ArmModel

POSITION_TOLERANCE_M = 2e-4
ROTATION_TOLERANCE_RAD = 2e-3
STEP_S = 1.0
LARGEST_JOINT_STEP_RAD = 0.4


class InverseKinematics:
    """Solves for one posture at a time, from a seed, staying near a rest posture."""

    def __init__(self, arm: ArmModel, posture_cost: float = 1e-3) -> None:
        self._arm = arm
        model = arm.model.copy()
        model.lowerPositionLimit = arm.q_min
        model.upperPositionLimit = arm.q_max
        self._model = model
        self._data = model.createData()
        self._limits = [ConfigurationLimit(model, config_limit_gain=0.9)]
        self._posture_cost = posture_cost

    def solve(self, X_base_tool: np.ndarray, q_seed: np.ndarray, iterations: int = 60) -> np.ndarray | None:
        """A posture that puts the fingertip at X_base_tool (4, 4), or None.

        Args:
            X_base_tool: Wanted pose of the tool frame.
            q_seed: Where to start and what to stay near, shape (dof,).
            iterations: Largest number of steps.
        """
        goal = pin.SE3(X_base_tool[:3, :3], X_base_tool[:3, 3])
        tip = FrameTask(self._arm.arm.tool_frame, position_cost=1.0, orientation_cost=0.3, lm_damping=1e-3)
        rest = PostureTask(cost=self._posture_cost)
        tip.set_target(goal)
        q_start = np.clip(q_seed, self._arm.q_min, self._arm.q_max)
        rest.set_target(q_start)
        configuration = pink.Configuration(self._model, self._data, q_start)
        for k in range(iterations):
            if self._reached(configuration, goal):
                return configuration.q.copy()
            tasks = [tip, rest] if k < iterations // 2 else [tip]
            try:
                velocity = pink.solve_ik(
                    configuration,
                    tasks,
                    STEP_S,
                    solver="proxqp",
                    limits=self._limits,
                    damping=1e-8,
                    safety_break=False,
                )
            except pink.exceptions.PinkError:
                return None  # the programme has no solution from this seed; another seed may
            largest = float(np.abs(velocity).max()) * STEP_S
            if largest < 1e-9:
                return None
            velocity *= min(1.0, LARGEST_JOINT_STEP_RAD / largest)
            # The solver keeps limits only to its own tolerance; without the clip pink warns about 1e-6 rad.
            q = np.clip(
                configuration.q + velocity * STEP_S,
                self._model.lowerPositionLimit,
                self._model.upperPositionLimit,
            )
            configuration.update(q)
        return configuration.q.copy() if self._reached(configuration, goal) else None

    def solve_any(self, X_base_tool: np.ndarray, q_seeds: Iterable[np.ndarray]) -> list[np.ndarray]:
        """All distinct postures found from the seeds, in the seeds' order."""
        found: list[np.ndarray] = []
        for q_seed in q_seeds:
            q = self.solve(X_base_tool, q_seed)
            if q is not None and all(np.abs(q - other).max() > 0.05 for other in found):
                found.append(q)
        return found

    def _reached(self, configuration: pink.Configuration, goal: pin.SE3) -> bool:
        error = configuration.get_transform_frame_to_world(self._arm.arm.tool_frame).actInv(goal)
        twist = pin.log6(error).vector
        return bool(
            np.linalg.norm(twist[:3]) < POSITION_TOLERANCE_M
            and np.linalg.norm(twist[3:]) < ROTATION_TOLERANCE_RAD
            and self._arm.inside_limits(configuration.q)
        )


def seeds_around(
    arm: ArmModel, q_first: np.ndarray, rng: np.random.Generator, count: int = 8
) -> list[np.ndarray]:
    """The first posture, then random ones near it and across the joint ranges."""
    spread = 0.5 * (arm.q_max - arm.q_min)
    middle = 0.5 * (arm.q_max + arm.q_min)
    seeds = [q_first]
    for k in range(count - 1):
        if k % 2 == 0:
            seeds.append(np.clip(q_first + rng.normal(0.0, 0.5, len(q_first)), arm.q_min, arm.q_max))
        else:
            seeds.append(middle + 0.6 * spread * rng.uniform(-1.0, 1.0, len(q_first)))
    return seeds
