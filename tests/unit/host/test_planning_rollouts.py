"""What rollouts are made of: ramps of joint targets, and the push as the part turns."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from s2r_host.planning.hook import Hook
from s2r_host.planning.rollouts import ramp

RNG = np.random.default_rng(0)
HINGE = np.array([2.0, -1.0, 2.0]) / 3.0
HOOK = Hook(
    p_part=np.array([0.1, 0.2, 0.3]),
    R_part_tool=np.eye(3),
    push_part=np.array([0.01, 0.02, -0.005]),
    q=np.zeros(7),
    route=np.zeros((4, 7)),
    approach=np.zeros((0, 7)),
    axis_part=HINGE,
    s_start=0.0,
    follow=1.0,
)


@pytest.mark.parametrize("substeps", [1, 2, 5, 25])
def test_ramps_are_straight_and_reach_every_target_at_the_end_of_its_step(substeps):
    targets = RNG.normal(size=(4, 7, 3))
    found = ramp(targets, substeps)
    assert found.shape == (4, 6 * substeps, 3)
    assert np.array_equal(found[:, substeps - 1 :: substeps], targets[:, 1:])
    steps = np.diff(np.concatenate([targets[:, :1], found], axis=1), axis=1)
    expected = np.repeat(np.diff(targets, axis=1) / substeps, substeps, axis=1)
    assert steps == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("s", [0.0, 0.7, -2.0])
def test_the_push_turns_with_a_hinge(s):
    quat_wxyz, turned = np.empty(4), np.empty(3)
    mujoco.mju_axisAngle2Quat(quat_wxyz, HINGE, s)
    mujoco.mju_rotVecQuat(turned, HOOK.push_part / np.linalg.norm(HOOK.push_part), quat_wxyz)
    assert HOOK.push_as_part_moves @ (1.0, np.cos(s), np.sin(s)) == pytest.approx(turned)


def test_the_push_stays_as_it_is_on_a_slide():
    slide = replace(HOOK, axis_part=np.zeros(3))
    ahead = HOOK.push_part / np.linalg.norm(HOOK.push_part)
    assert slide.push_as_part_moves @ (1.0, np.cos(0.4), np.sin(0.4)) == pytest.approx(ahead)


@pytest.mark.parametrize("away", [[0.0, 0.0, 1.0], HOOK.push_part, [0.5, -0.3, 0.2]])
def test_distance_beside_a_place_is_seen_through_the_funnel(away):
    """Whatever angle the tool makes with the push, the push's own direction included."""
    away = np.array(away) / np.linalg.norm(away)
    across = np.linalg.svd(away[None])[2][1]
    hook = replace(HOOK, R_part_tool=np.column_stack([across, np.cross(-away, across), -away]))
    tip = hook.p_part + RNG.normal(scale=0.05, size=(50, 3))
    ahead = hook.push_part / np.linalg.norm(hook.push_part)
    nearest = np.clip((tip - hook.p_part) @ ahead, 0.0, np.linalg.norm(hook.push_part))
    left = tip - hook.p_part - nearest[:, None] * ahead
    height = left @ away
    beside = np.linalg.norm(left - height[:, None] * away, axis=1)
    assert hook.distance(tip) == pytest.approx(np.hypot(beside, height - np.minimum(0.05, 5.0 * beside)))
