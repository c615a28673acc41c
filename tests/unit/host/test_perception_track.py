"""Live state: following a part through depth frames."""

import numpy as np
import pytest

from s2r_host.perception import estimate_joint, synthetic
from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.track import JointTracker


@pytest.fixture(scope="module", params=["drawer", "laptop"])
def case(request):
    make = {"drawer": synthetic.drawer_pair, "laptop": synthetic.laptop_pair}[request.param]
    pair = make(np.random.default_rng(11))
    estimate = estimate_joint(pair.before, pair.after)
    tolerance = 0.003 if estimate.joint_type == "prismatic" else np.radians(2)
    return pair, estimate, tolerance


def test_both_views_give_the_values_of_the_estimate(case):
    pair, estimate, tolerance = case
    tracker = JointTracker.of(estimate)
    for frame, value in ((pair.after, estimate.delta), (pair.before, 0.0), (pair.after, estimate.delta)):
        state = tracker.update(frame)
        assert state.value == pytest.approx(value, abs=tolerance)
        assert state.interval90[0] < state.value < state.interval90[1]


def test_part_half_hidden_by_the_arm_is_still_followed(case):
    pair, estimate, tolerance = case
    tracker = JointTracker.of(estimate)
    columns = np.flatnonzero(estimate.moved_mask_before.any(axis=0))
    arm = np.zeros(pair.before.depth_m.shape, bool)
    arm[:, : int(np.median(columns))] = True
    assert tracker.update(pair.before, ignore=arm).value == pytest.approx(0.0, abs=2 * tolerance)
    in_front = np.where(arm, 0.3, pair.before.depth_m).astype(np.float32)
    occluded = DepthFrame(in_front, pair.before.K, pair.before.X_base_camera, None)
    assert tracker.update(occluded).value == pytest.approx(0.0, abs=2 * tolerance)


def test_a_mask_of_another_size_is_refused_with_both_sizes(case):
    pair, estimate, _ = case
    h, w = pair.before.depth_m.shape
    with pytest.raises(BadViewError, match=rf"ignore has shape \(3, 3\), the frame's depth \({h}, {w}\)"):
        JointTracker.of(estimate).update(pair.before, ignore=np.zeros((3, 3), bool))


def test_covered_camera_loses_the_part_and_the_next_frame_finds_it(case):
    pair, estimate, tolerance = case
    tracker = JointTracker.of(estimate)
    hand = np.full_like(pair.before.depth_m, 0.3)
    lost = tracker.update(DepthFrame(hand, pair.before.K, pair.before.X_base_camera, None))
    assert lost.value is None
    assert lost.interval90 is None
    assert tracker.update(pair.before).value == pytest.approx(0.0, abs=tolerance)


def test_part_taken_away_is_lost_not_guessed(case):
    pair, estimate, _ = case
    tracker = JointTracker.of(estimate)
    far = np.where(estimate.moved_mask_before, pair.before.depth_m + 0.5, pair.before.depth_m)
    gone = DepthFrame(far.astype(np.float32), pair.before.K, pair.before.X_base_camera, None)
    state = tracker.update(gone)
    assert state.value is None or state.seen < 0.4


def test_part_without_surface_is_refused(case):
    _, estimate, _ = case
    with pytest.raises(BadViewError, match="the part has 3 points"):
        JointTracker(np.zeros((3, 3)), np.zeros((3, 3)), estimate.motion, (0.0, 1.0))
