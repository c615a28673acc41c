"""Each reward term: its sign, and its value at points worked out by hand."""

import pytest

from s2r_host import _native as terms
from s2r_host.planning.rewards import native_weights
from s2r_host.planning.settings import RewardWeights

GIVEN = RewardWeights(contact_after=5.0)
W = native_weights(GIVEN, 7)
TASK = terms.Task(s_initial=-0.03, s_target=0.17, tolerance=0.002, prismatic=True)


def test_distance_is_a_penalty_that_grows():
    near, far = terms.r_dist(0.001, 0.0, W), terms.r_dist(0.2, 0.0, W)
    assert far < near < 0.0


def test_distance_is_the_papers_square_near_the_part_and_linear_far_from_it():
    assert terms.r_dist(1e-3, 0.0, W) == pytest.approx(-GIVEN.distance * 1e-6, rel=1e-3)
    step = terms.r_dist(10.0, 0.0, W) - terms.r_dist(11.0, 0.0, W)
    assert step == pytest.approx(2.0 * GIVEN.distance * GIVEN.distance_width_m, rel=1e-3)


def test_wrong_orientation_is_penalised_like_a_distance():
    assert terms.r_dist(0.0, 0.1, W) == pytest.approx(terms.r_dist(0.1 * GIVEN.turn_m, 0.0, W))


def test_approach_costs_its_weight_at_the_start_and_nothing_on_target():
    assert terms.r_target(-0.03, TASK, W) == pytest.approx(-50.0)
    assert terms.r_target(0.07, TASK, W) == pytest.approx(-25.0)
    assert terms.r_target(0.17, TASK, W) == pytest.approx(0.0)


def test_overshoot_is_not_rewarded():
    assert terms.r_target(0.22, TASK, W) == pytest.approx(terms.r_target(0.12, TASK, W))


def test_closing_is_rewarded_like_opening():
    closing = terms.Task(s_initial=0.17, s_target=-0.03, tolerance=0.002, prismatic=True)
    assert terms.r_target(0.07, closing, W) == pytest.approx(-25.0)


def test_success_is_paid_within_the_band_only():
    assert terms.r_success(0.1681, TASK, W) == 20.0
    assert terms.r_success(0.1679, TASK, W) == 0.0


@pytest.mark.parametrize(
    ("s", "touches", "collides", "expected"),
    [
        (0.05, True, False, 10.0),  # touch with progress
        (0.05, False, False, 0.0),  # progress without touch
        (-0.03, True, False, 0.0),  # touch without progress
        (-0.0299, True, False, 0.0),  # less progress than the band is rounding
        (0.17, True, False, -5.0),  # still touching once on target
        (0.05, True, True, -60.0),  # a collision wins
        (0.05, False, True, -60.0),
    ],
)
def test_contact_is_paid_with_progress_and_collision_wins(s, touches, collides, expected):
    assert terms.r_contact(s, touches, collides, TASK, W) == pytest.approx(expected)


def test_moving_backwards_costs_as_much_as_forwards():
    forward, backward = (terms.r_reg([v] * 7, [0.0] * 7, W) for v in (0.5, -0.5))
    assert forward == backward == pytest.approx(-0.03 * 0.5 * 13.0)


def test_acceleration_costs_too():
    assert terms.r_reg([0.0] * 7, [-2.0] * 7, W) == pytest.approx(-0.01 * 2.0 * 13.0)


def test_numbers_of_another_arm_are_refused():
    with pytest.raises(ValueError, match="a number per joint: 7"):
        terms.r_reg([0.0] * 6, [0.0] * 6, W)


@pytest.mark.parametrize(("dof", "weight"), [(6, 12.0), (9, 15.0)])
def test_joint_weights_fit_arms_with_other_joint_counts(dof, weight):
    speeds = [1.0] * dof
    assert terms.r_reg(speeds, [0.0] * dof, native_weights(GIVEN, dof)) == pytest.approx(-0.03 * weight)


def test_load_below_the_free_share_costs_nothing():
    assert terms.r_load([-0.39] * 7, W) == pytest.approx(0.0)
    assert terms.r_load([0.0, -0.9], W) == pytest.approx(-20.0 * 0.5)


def test_pressing_across_the_motion_costs_beyond_the_free_force():
    assert terms.r_press(GIVEN.press_free_N, W) == 0.0
    assert terms.r_press(GIVEN.press_free_N + 20.0, W) == pytest.approx(-20.0 * GIVEN.press)


def test_a_fast_object_costs_with_the_square_of_its_speed():
    assert terms.r_calm(-0.2, TASK, W) == pytest.approx(4.0 * terms.r_calm(0.1, TASK, W))
    assert terms.r_calm(0.1, TASK, W) < 0.0
    hinge = terms.Task(0.0, 1.0, 0.01, prismatic=False)
    assert terms.r_calm(5.0, hinge, W) == pytest.approx(terms.r_calm(1.0, TASK, W))
