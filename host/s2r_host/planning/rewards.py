"""The reward of a rollout: what it compares with, its weights, and what else it has to know.

The terms themselves, each with the paper's form and the repair it needed, are in ``host/native/rewards.hpp``; what they
need is read from the coarse model's records in ``host/native/scorer.cpp``.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from s2r_host import _native
from s2r_host._native import Task
from s2r_host.planning.hook import Hook
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings, RewardWeights

__all__ = ["Task", "make_scorer", "native_weights"]


def native_weights(weights: RewardWeights, dof: int) -> _native.RewardWeights:
    """The weights for an arm with ``dof`` joints; of more joints than were given weights the last one repeats."""
    given = weights.joints[:dof]
    fields: dict[str, Any] = asdict(weights)
    fields["joints"] = given + (weights.joints[-1],) * (dof - len(given))
    return _native.RewardWeights(**fields)


def make_scorer(
    scene: Scene, settings: PlanSettings, hook: Hook, substeps: int, R_world_part: np.ndarray
) -> _native.Scorer:
    """What judges rollouts.

    Args: the models; settings; place; physics steps of a control step; the part's orientation at s = 0, (3, 3).
    """
    tau_max = scene.arm.limits.tau_max
    return _native.Scorer(
        place=hook.place,
        weights=native_weights(settings.weights, scene.dof),
        s_qpos=scene.s_qpos,
        s_dof=scene.s_dof,
        substeps=substeps,
        control_dt_s=settings.control_dt_s,
        stiffness=(settings.servo.kp / tau_max).tolist(),  # both per torque limit
        damping=(settings.servo.kd / tau_max).tolist(),
        R_world_part=R_world_part.tolist(),
    )
