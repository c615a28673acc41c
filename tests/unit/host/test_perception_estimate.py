"""One joint from two views of made-up objects: type, axis, amount, sense, and the reasons to answer nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.perception import AbstainError, BadViewError, Cloud, DepthFrame, JointMotion, estimate_joint
from s2r_host.perception import synthetic as scenes
from s2r_host.perception.motion import line_distance, rotation


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.fixture(scope="module")
def drawer():
    return scenes.drawer_pair(np.random.default_rng(4))


@pytest.fixture(scope="module")
def drawer_estimate(drawer):
    return estimate_joint(drawer.before, drawer.after)


@pytest.fixture(scope="module")
def laptop():
    return scenes.laptop_pair(np.random.default_rng(8))


@pytest.fixture(scope="module")
def laptop_estimate(laptop):
    return estimate_joint(laptop.before, laptop.after)


def test_a_pushed_drawer_is_prismatic_with_axis_amount_and_sense(drawer, drawer_estimate):
    assert (drawer_estimate.joint_type, drawer_estimate.unit) == ("prismatic", "m")
    assert angle_deg(drawer_estimate.axis_direction, drawer.motion.direction) < 1.5
    assert drawer_estimate.delta == pytest.approx(drawer.motion.delta, abs=0.001)


def test_the_drawer_front_is_in_the_part_and_the_cabinet_is_not(drawer, drawer_estimate):
    found, true = drawer_estimate.moved_mask_before, drawer.part_before
    assert (found & true).sum() / true.sum() > 0.7
    assert (found & true).sum() / found.sum() > 0.85


@pytest.mark.parametrize("handle", [True, False])
def test_a_panel_that_slides_within_its_own_plane_is_not_taken_for_its_two_ends(handle):
    """What changes are the strip it leaves and the strip it covers; between them the panel looks as before."""
    rng = np.random.default_rng(2)
    K = np.array([[460.0, 0, 319.5], [0, 460.0, 239.5], [0, 0, 1]])

    def box(size, p):
        X = np.eye(4)
        X[:3, 3] = p
        return scenes.Box(X, np.array(size))

    static = [box((0.3, 0.02, 0.3), (0.9, y, 0.15)) for y in (-0.3, 0.3)]
    static += [box((2, 2, 0.02), (0.8, 0, -0.01)), box((0.02, 0.6, 0.3), (1.04, 0, 0.15))]
    part = [box((0.01, 0.3, 0.26), (0.745, -0.1, 0.15))]
    if handle:
        part.append(box((0.02, 0.02, 0.08), (0.73, 0.0, 0.15)))
    motion = JointMotion("prismatic", np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.16)
    X_camera = scenes.look_at(np.array([0.05, -0.2, 0.5]), np.array([0.8, 0.0, 0.1]))
    seen = scenes.pair(static, part, motion, K, (480, 640), X_camera, rng)
    found = estimate_joint(seen.before, seen.after)
    assert found.joint_type == "prismatic"
    assert angle_deg(found.axis_direction, motion.direction) < 1.5
    assert found.delta == pytest.approx(0.16, abs=0.004)


def test_a_turned_lid_is_revolute_with_axis_hinge_and_angle(laptop, laptop_estimate):
    assert (laptop_estimate.joint_type, laptop_estimate.unit) == ("revolute", "rad")
    assert angle_deg(laptop_estimate.axis_direction, laptop.motion.direction) < 2.0
    assert np.degrees(abs(laptop_estimate.delta - laptop.motion.delta)) < 1.0
    hinge = line_distance(laptop.motion.origin, laptop.motion.direction, laptop_estimate.axis_origin_m[None])[
        0
    ]
    assert hinge < 0.006


def test_truth_lies_in_the_intervals(drawer, drawer_estimate, laptop, laptop_estimate):
    for pair, estimate in ((drawer, drawer_estimate), (laptop, laptop_estimate)):
        intervals = estimate.intervals90
        assert intervals.delta[0] < pair.motion.delta < intervals.delta[1]
        assert (
            np.radians(angle_deg(estimate.axis_direction, pair.motion.direction)) < intervals.axis_angle_rad
        )


def test_swapped_views_give_the_opposite_sense(drawer, drawer_estimate):
    back = estimate_joint(drawer.after, drawer.before)
    assert angle_deg(back.axis_direction, -drawer_estimate.axis_direction) < 1.5
    assert back.delta == pytest.approx(drawer_estimate.delta, abs=0.001)


def test_reversing_an_estimate_describes_the_same_motion(drawer_estimate):
    other = drawer_estimate.reversed()
    np.testing.assert_allclose(other.motion.transform(), drawer_estimate.motion.transform(), atol=1e-12)
    assert other.intervals90.delta[0] < other.delta < other.intervals90.delta[1] < 0


def test_the_same_seed_gives_the_same_answer(drawer, drawer_estimate):
    again = estimate_joint(drawer.before, drawer.after)
    np.testing.assert_array_equal(again.axis_direction, drawer_estimate.axis_direction)
    assert again.delta == drawer_estimate.delta


def test_bare_clouds_without_a_camera_still_give_the_drawer(drawer):
    clouds = []
    for frame in (drawer.before, drawer.after):
        points = frame.points_base().reshape(-1, 3)
        clouds.append(Cloud(points[np.isfinite(points).all(axis=1)]))
    estimate = estimate_joint(*clouds)
    assert estimate.joint_type == "prismatic"
    assert angle_deg(estimate.axis_direction, drawer.motion.direction) < 4.0
    assert estimate.delta == pytest.approx(drawer.motion.delta, abs=0.003)
    assert any("without a camera" in warning for warning in estimate.warnings)


def noisy_again(pair: scenes.Pair, seed: int) -> DepthFrame:
    noise = 0.001 * np.random.default_rng(seed).standard_normal(pair.before.depth_m.shape)
    depth = np.where(pair.before.depth_m > 0, pair.before.depth_m + noise, 0).astype(np.float32)
    return replace(pair.before, depth_m=depth)


def test_no_motion_is_said_so(drawer):
    with pytest.raises(AbstainError, match="no motion seen"):
        estimate_joint(drawer.before, noisy_again(drawer, 1))


def test_identical_views_are_refused(drawer):
    with pytest.raises(BadViewError, match="identical"):
        estimate_joint(drawer.before, drawer.before)


def test_views_of_different_places_are_refused(drawer):
    pose = drawer.after.X_base_camera.copy()
    pose[:3, 3] += 5.0
    with pytest.raises(BadViewError, match="do not overlap"):
        estimate_joint(drawer.before, replace(drawer.after, X_base_camera=pose))


def test_a_tiny_motion_is_not_answered():
    pair = scenes.laptop_pair(np.random.default_rng(8), turn_rad=np.radians(1.2))
    with pytest.raises(AbstainError, match=r"too small|no motion"):
        estimate_joint(pair.before, pair.after)


def test_a_moved_camera_is_noticed(drawer):
    pose = drawer.after.X_base_camera.copy()
    pose[:3, :3] = rotation(np.array([0.0, 0.6, 0.8]), 0.03) @ pose[:3, :3]
    pose[:3, 3] += [0.012, -0.01, 0.015]
    with pytest.raises(AbstainError, match="camera moved"):
        estimate_joint(drawer.before, replace(drawer.after, X_base_camera=pose))


def test_views_of_two_calibrated_cameras_agree(laptop):
    """The second view from elsewhere: same world, another known pose."""
    rng = np.random.default_rng(5)
    K, shape = laptop.before.K, laptop.before.depth_m.shape
    static, part, motion = box_world()
    p_target = np.array([0.68, 0.0, 0.1])
    X_a = scenes.look_at(p_target + np.array([-0.6, -0.2, 0.45]), p_target)
    X_b = scenes.look_at(p_target + np.array([-0.55, -0.32, 0.5]), p_target)
    a = scenes.pair(static, part, motion, K, shape, X_a, rng)
    b = scenes.pair(static, part, motion, K, shape, X_b, rng)
    estimate = estimate_joint(a.before, b.after)
    assert estimate.joint_type == "prismatic"
    assert angle_deg(estimate.axis_direction, motion.direction) < 3.0
    assert estimate.delta == pytest.approx(motion.delta, abs=0.002)


def box_world() -> tuple[list[scenes.Box], list[scenes.Box], JointMotion]:
    """A small box that slides towards a cabinet on a table."""

    def at(x: float, y: float, z: float, size: tuple[float, float, float]) -> scenes.Box:
        X = np.eye(4)
        X[:3, 3] = x, y, z
        return scenes.Box(X, np.array(size))

    table = at(0.7, 0.0, -0.015, (1.2, 1.6, 0.03))
    cabinet = at(0.82, 0.0, 0.12, (0.3, 0.4, 0.24))
    drawer = at(0.62, 0.02, 0.15, (0.1, 0.3, 0.12))
    return [table, cabinet], [drawer], JointMotion("prismatic", np.zeros(3), np.array([1.0, 0, 0]), 0.04)


def test_a_region_that_holds_nothing_is_refused_with_what_the_views_span():
    pair = scenes.drawer_pair(np.random.default_rng(11))
    with pytest.raises(
        BadViewError, match=r"lies in the region 5,6,5,6,5,6; the views span x .* in their frame"
    ):
        estimate_joint(pair.before, pair.after, region=(5.0, 6.0, 5.0, 6.0, 5.0, 6.0))


def test_a_masked_robot_does_not_count():
    rng = np.random.default_rng(7)
    static, part, motion = box_world()
    K = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]])
    p_target = np.array([0.68, 0.0, 0.1])
    X = scenes.look_at(p_target + np.array([-0.6, -0.2, 0.45]), p_target)
    arm = scenes.Box(np.eye(4), np.array([0.08, 0.08, 0.5]))
    arm.X_base_box[:3, 3] = 0.5, 0.3, 0.25
    arm_after = scenes.Box(arm.X_base_box.copy(), arm.size)
    arm_after.X_base_box[:3, 3] += [0.05, -0.1, 0.0]
    exact, which = scenes.render([*static, *part, arm], K, (360, 640), X)
    carried = [scenes.Box(motion.transform() @ box.X_base_box, box.size) for box in part]
    exact_after, which_after = scenes.render([*static, *carried, arm_after], K, (360, 640), X)
    estimate = estimate_joint(
        DepthFrame(scenes.stereo_like(exact, rng), K, X),
        DepthFrame(scenes.stereo_like(exact_after, rng), K, X),
        ignore_mask_before=grown(which == 3),
        ignore_mask_after=grown(which_after == 3),
    )
    assert estimate.explained > 0.7
    assert angle_deg(estimate.axis_direction, motion.direction) < 1.5


def grown(mask: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.dilate(mask.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
