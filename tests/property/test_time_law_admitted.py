"""Random paths, timed, are admitted by the executor at first try: no second attempt, no clamping, no luck."""

import os

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from s2r_executor.admission import Admission
from s2r_executor.config import AdmissionConfig, CoreConfig
from s2r_executor.plan import CommandRefusedError, PlanRequest
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.obstacles import table_obstacle
from s2r_host.trajectory import time_law
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
ADMISSION = Admission(ARM, AdmissionConfig(), CoreConfig())
# S2R_PLANS=1000 is the full count; it takes minutes.
PLANS = int(os.environ.get("S2R_PLANS", "25"))
BATCH = 5


def random_path(rng: np.random.Generator) -> np.ndarray:
    """Targets as a planner makes them from a random posture: bounded steps, noisy or smooth, a held end."""
    limits = ARM.limits
    low, high = limits.q_min + 0.05, limits.q_max - 0.05
    start = np.clip(ARM.q_home + rng.uniform(-0.5, 0.5, ARM.dof), low, high)
    steps = rng.uniform(-0.05, 0.05, (rng.integers(4, 60), ARM.dof))
    steps = gaussian_filter1d(steps, rng.uniform(0.1, 4.0), axis=0)
    steps *= rng.uniform(0.2, 1.0) * 0.05 / np.abs(steps).max()
    q = np.clip(start + np.cumsum(steps, axis=0), low, high)
    return np.concatenate([start[None], q, np.repeat(q[-1:], rng.integers(0, 11), axis=0)])


@pytest.fixture(scope="module")
def checker() -> CollisionChecker:
    """The planner never proposes a path through the arm or the table; nor does this test."""
    return CollisionChecker(ArmModel(ARM), [table_obstacle()], Clearance(table_m=0.03, self_m=0.02))


@pytest.mark.parametrize("batch", range((PLANS + BATCH - 1) // BATCH))
def test_random_plans_are_admitted_at_first_try(batch, checker):
    rng = np.random.default_rng([7, batch])
    admitted = 0
    while admitted < BATCH:
        path = random_path(rng)
        if not checker.path_is_free(path):
            continue
        row = int(rng.integers(0, len(path) - 1)) if rng.random() < 0.7 else None
        trajectory = time_law(path, ARM, contact_row=row)
        plan = PlanRequest(ARM.joint_names, trajectory.t, trajectory.q, trajectory.dq, trajectory.ddq)
        try:
            ADMISSION.admit(plan, path[0])
        except CommandRefusedError as error:
            pytest.fail(f"batch {batch}, plan {admitted}: {error}")
        admitted += 1
