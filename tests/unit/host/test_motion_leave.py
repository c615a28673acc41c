"""Out of touch with what a camera sees, where nothing is known of how the arm came there."""

import numpy as np
import pytest

from s2r_host.errors import NoMotionError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.leave import way_out_of_touch
from s2r_host.motion.obstacles import cloud_obstacle, table_obstacle
from s2r_host.run.session import load_arm


@pytest.fixture(scope="module")
def arm():
    return ArmModel(load_arm("xmate3pro"))


def wall(arm, ahead_m, half_m=0.12):
    """Points of a plane across the finger, so far ahead of the fingertip at home, and of where the camera is."""
    X = arm.tool_pose(arm.arm.q_home)
    a, b = np.meshgrid(np.arange(-half_m, half_m, 0.005), np.arange(-half_m, half_m, 0.005))
    flat = np.stack([a.ravel(), b.ravel(), np.full(a.size, ahead_m)], axis=1)
    return flat @ X[:3, :3].T + X[:3, 3], X[:3, 3] - 0.6 * X[:3, 2]


def test_a_fingertip_on_a_surface_goes_back_along_itself(arm):
    p, p_camera = wall(arm, 0.002)
    q = arm.arm.q_home
    checker = CollisionChecker(arm, [table_obstacle(), cloud_obstacle(p, p_camera)], Clearance())
    assert checker.touching(q) is not None
    path = way_out_of_touch(checker, p, q)
    assert path[0] == pytest.approx(q)
    assert checker.is_free(path[-1])
    X, out = arm.tool_pose(q), arm.tool_pose(path[-1])[:3, 3]
    away = out - X[:3, 3]
    assert away @ -X[:3, 2] == pytest.approx(np.linalg.norm(away), rel=1e-3)


def test_an_arm_that_is_walled_in_stays_and_says_so(arm):
    q, X = arm.arm.q_home, arm.tool_pose(arm.arm.q_home)
    rng = np.random.default_rng(1)
    around = rng.normal(size=(20_000, 3))
    around = X[:3, 3] - 0.1 * X[:3, 2] + 0.19 * around / np.linalg.norm(around, axis=1, keepdims=True)
    p_camera = X[:3, 3] + [0.0, 0.0, 1.0]
    checker = CollisionChecker(arm, [table_obstacle(), cloud_obstacle(around, p_camera)], Clearance())
    with pytest.raises(NoMotionError, match="no straight way"):
        way_out_of_touch(checker, around, q)
