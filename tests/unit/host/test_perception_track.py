"""Live state: following a part through depth frames."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from s2r_host.perception import estimate_joint, synthetic
from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.intervals import Intervals
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.track import JointTracker
from s2r_host.perception.track_still import StillSurface
from s2r_host.perception.view import DepthView
from s2r_sim.objects.pairs import camera_of, draw_pair
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split


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


@pytest.mark.parametrize("count", [0, 40])
def test_an_estimate_with_too_little_surface_is_refused(case, count):
    _, estimate, _ = case
    with pytest.raises(BadViewError, match=f"the part has {count} points with a surface, tracking needs 50"):
        JointTracker.of(with_surface(estimate, count))


def with_surface(estimate, count):
    """An estimate of whose part so many points have a normal, all of them in the view before."""
    normal_ok = estimate.view_before.normal_ok & estimate.parts.before
    normal_ok[np.flatnonzero(normal_ok)[count:]] = False
    before, after = copy(estimate.view_before), copy(estimate.view_after)
    before.normal_ok, after.normal_ok = normal_ok, np.zeros_like(after.normal_ok)
    return replace(estimate, view_before=before, view_after=after)


def test_a_range_without_values_is_refused(case):
    _, estimate, _ = case
    with pytest.raises(BadViewError, match=r"value_range goes from 0\.3 to 0\.1"):
        JointTracker.of(estimate, (0.3, 0.1))


def test_a_joint_with_the_opposite_sense_is_followed_too(case):
    pair, estimate, tolerance = case
    tracker = JointTracker.of(estimate.reversed())
    assert tracker.update(pair.after).value == pytest.approx(-estimate.delta, abs=tolerance)
    assert tracker.update(pair.before).value == pytest.approx(0.0, abs=tolerance)


def test_a_lid_whose_edge_alone_is_in_sight_is_not_taken_for_a_shut_one():
    pair = draw_pair("laptop", Split.TEST, 500)
    before, after = (DepthFrame(d, pair.K, pair.X_base_camera) for d in (pair.depth_before, pair.depth_after))
    tracker = JointTracker.of(estimate_joint(before, after))
    model = table_scene(pair.spec).compile()
    camera = camera_of(pair, model)
    for degrees in (41, 33, 24, -1):  # seen from the one side, on its edge, from the other side
        q = pair.joint.q_start + np.sign(pair.delta) * np.radians(degrees)
        state = tracker.update(
            DepthFrame(camera.capture(qpos_at(model, q)).depth_m, pair.K, pair.X_base_camera)
        )
        assert state.value is not None
        assert abs(state.value - np.radians(degrees)) < np.radians(2)
        assert state.interval90[0] < np.radians(degrees) < state.interval90[1]


K_SMALL = np.array([[200.0, 0, 80], [0, 200.0, 60], [0, 0, 1]])
TOWARDS = JointMotion("prismatic", np.zeros(3), np.array([0.0, 0.0, -1.0]), 0.1)


def wall(depth_m: float) -> DepthFrame:
    """A camera at the origin that looks along z at a wall."""
    return DepthFrame(np.full((120, 160), depth_m, np.float32), K_SMALL, np.eye(4))


def plate(**more) -> JointTracker:
    """A plate at 0.8 m that slides towards the camera."""
    x, y = np.meshgrid(np.linspace(-0.1, 0.1, 15), np.linspace(-0.1, 0.1, 15))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.8)], axis=1)
    return JointTracker(points, np.tile([0.0, 0.0, -1.0], (len(points), 1)), TOWARDS, (-0.1, 0.3), **more)


def test_what_stands_still_is_not_the_part():
    v, u = np.mgrid[:120, :160]
    known = np.stack([0.8 * (u - 80) / 200, 0.8 * (v - 60) / 200, np.full(u.shape, 0.8)], axis=-1).reshape(
        -1, 3
    )
    assert plate().update(wall(0.8)).value == pytest.approx(0.0, abs=1e-4)
    tracker = plate(still=StillSurface(known))
    assert tracker.update(wall(0.8)).value is None  # the part would hide the wall, and the wall is seen
    assert tracker.update(wall(0.7)).value == pytest.approx(0.1, abs=1e-4)


def test_a_part_that_is_looked_through_is_lost():
    tracker = plate(start=0.25)
    state = tracker.update(wall(1.2))
    assert state.value is None
    half = wall(1.2).depth_m
    half[:, :80] = 0.55  # one half of the picture fits, through the other the camera looks
    assert plate(start=0.25).update(DepthFrame(half, K_SMALL, np.eye(4))).value is None


def test_the_interval_holds_what_the_axis_is_known_to():
    """A lid of 0.2 m whose axis is known to 10 mm: where it was seen exact, turned on up to 10 mm aside."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.0, 15), np.linspace(-0.1, 0.1, 15))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.8)], axis=1)
    hinge = JointMotion("revolute", np.array([0.0, 0.0, 0.8]), np.array([0.0, 1.0, 0.0]), 0.1)
    ends = {}
    for value in (0.0, -1.0):
        tracker = JointTracker(
            points, np.tile([0.0, 0.0, -1.0], (len(points), 1)), hinge, (-1.5, 0.5), value,
            Intervals(0.01, 0.010, (0.09, 0.11)),
        )  # fmt: skip
        u = np.arange(160) - 80
        turned = 0.8 / (1.0 + np.tan(value) * u / 200.0)  # the plane z = 0.8 - x tan(value)
        state = tracker.update(DepthFrame(np.tile(turned, (120, 1)).astype(np.float32), K_SMALL, np.eye(4)))
        assert state.value == pytest.approx(value, abs=0.02)
        ends[value] = state.interval90[1] - state.interval90[0]
    assert ends[-1.0] > 4 * ends[0.0]


@pytest.mark.parametrize(("w", "h"), [(640, 360), (1280, 720), (1281, 721), (1999, 1125)])
def test_all_of_a_frame_knows_what_stands_still_however_wide_it_is(w, h):
    """Views are thinned: of a frame 1280 pixels wide a quarter of the pixels knew it."""
    K = np.array([[0.7 * w, 0.0, w / 2], [0.0, 0.7 * w, h / 2], [0.0, 0.0, 1.0]])
    rows = np.arange(h, dtype=np.float32)[:, None]
    depth = np.broadcast_to(1.0 / (1.2 + 0.6 * rows / h), (h, w)).astype(np.float32)  # a plane: linear in 1/z
    frame = DepthFrame(depth, K, np.eye(4))
    still = StillSurface(DepthView(frame).points).depth_in(frame)
    assert still.shape == (h, w)
    assert (still > 0).mean() > 0.99
    assert np.abs(still - frame.depth_m)[still > 0].max() < 0.002
