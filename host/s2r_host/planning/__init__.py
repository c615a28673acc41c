"""Sampling model-predictive control through contact: iCEM on MuJoCo batches."""

from s2r_host.planning.out_of_reach import OutOfReachError
from s2r_host.planning.planner import plan_manipulation
from s2r_host.planning.scene import SceneFileError
from s2r_host.planning.settings import (
    IcemSettings,
    PlanSettings,
    PlanSettingsError,
    RewardWeights,
    ServoSettings,
    Stage,
)
from s2r_host.planning.task import PlanRefusedError, PlanRequest, PlanResult, StepTrace

__all__ = [
    "IcemSettings",
    "OutOfReachError",
    "PlanRefusedError",
    "PlanRequest",
    "PlanResult",
    "PlanSettings",
    "PlanSettingsError",
    "RewardWeights",
    "SceneFileError",
    "ServoSettings",
    "Stage",
    "StepTrace",
    "plan_manipulation",
]
