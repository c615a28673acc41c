"""Quintic segments: end conditions and exact extrema."""

import numpy as np
import pytest

from s2r_host.trajectory import quintic
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError, check_positions
from s2r_protocol.arms import load_arm


def random_trajectory(seed: int, scale: float = 1.0) -> Trajectory:
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.3, 8))])
    q, dq, ddq = (scale * rng.normal(size=(9, 7)) for _ in range(3))
    return Trajectory(t, q, dq, ddq)


def test_segments_take_position_velocity_and_acceleration_at_both_ends():
    trajectory = random_trajectory(0)
    for k, values in enumerate((trajectory.q, trajectory.dq, trajectory.ddq)):
        assert trajectory.sample(trajectory.t)[k] == pytest.approx(values, abs=1e-9)
        T = np.diff(trajectory.t)[:, None]
        end = quintic.evaluate(quintic.derivative(trajectory.segments, k), np.ones((8, 7))) / T**k
        assert end == pytest.approx(values[1:], abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("order", [1, 2, 3])
def test_peaks_between_knots_are_exact(seed, order):
    trajectory = random_trajectory(seed)
    u = np.linspace(0.0, 1.0, 2001)[:, None, None]
    T = np.diff(trajectory.t)[:, None]
    dense = quintic.evaluate(quintic.derivative(trajectory.segments, order)[None], u) / T**order
    expected = np.abs(dense).max(axis=(0, 1))
    peak = trajectory.peak(order)
    assert (peak >= expected - 1e-9).all()
    assert peak == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_bounds_over_all_segments_are_the_bounds_of_the_widest(seed, order):
    c = quintic.derivative(random_trajectory(seed).segments, order)
    each_low, each_high = quintic.bounds(c)
    low, high = quintic.bounds_over(c)
    assert low == pytest.approx(each_low.min(axis=0), abs=1e-12)
    assert high == pytest.approx(each_high.max(axis=0), abs=1e-12)


def test_a_bulge_between_two_equal_knots_is_found():
    still = np.zeros((2, 1))
    speed = np.array([[1.0], [-1.0]])
    low, high = Trajectory(np.array([0.0, 1.0]), still, speed, still).range()
    assert low == pytest.approx(0.0)
    assert high[0] == pytest.approx(0.3125)


def test_constant_polynomials_have_bounds_too():
    low, high = quintic.bounds(np.array([[2.0, 0.0, 0.0, 0.0]]))
    assert low == pytest.approx(2.0)
    assert high == pytest.approx(2.0)


def test_sampling_holds_the_ends_outside_the_duration():
    trajectory = random_trajectory(1)
    assert trajectory.sample(-1.0)[0] == pytest.approx(trajectory.q[0])
    assert trajectory.sample(1e3)[0] == pytest.approx(trajectory.q[-1])


def test_stretching_keeps_the_path_and_divides_speed():
    trajectory = random_trajectory(2)
    slow = trajectory.stretched(2.0)
    assert slow.sample(0.6)[0] == pytest.approx(trajectory.sample(0.3)[0])
    assert slow.peak(1) == pytest.approx(trajectory.peak(1) / 2.0)
    assert slow.peak(3) == pytest.approx(trajectory.peak(3) / 8.0)


def test_position_outside_the_limits_is_refused_with_joint_and_value():
    arm = load_arm("xmate3pro")
    q = np.zeros((2, 7))
    q[1, 3] = 2.2
    trajectory = Trajectory(np.array([0.0, 1.0]), q, np.zeros((2, 7)), np.zeros((2, 7)))
    with pytest.raises(TrajectoryError, match=r"'joint4' \(index 3\): the path goes to 2.2000 rad"):
        check_positions(trajectory, arm)
