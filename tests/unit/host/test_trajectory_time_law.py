"""What the time law and the bridge refuse, and in which words."""

from itertools import pairwise

import numpy as np
import pytest

from s2r_host.trajectory import TimeLawSettings, TrajectoryError, point_to_point, time_law
from s2r_host.trajectory.path import smooth_path
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")


def test_a_path_that_does_not_move_is_refused():
    with pytest.raises(TrajectoryError, match="does not move"):
        time_law(np.repeat(ARM.q_home[None], 5, axis=0), ARM)


@pytest.mark.parametrize("contact_row", [None, 1])
@pytest.mark.parametrize("joint", [0, 6])
@pytest.mark.parametrize("way_rad", [1.1e-5, 3e-5, 1e-4])
def test_a_path_of_hundredths_of_a_milliradian_is_timed(way_rad, joint, contact_row):
    end = ARM.q_home.copy()
    end[joint] += way_rad
    trajectory = time_law(np.array([ARM.q_home, end]), ARM, contact_row=contact_row)
    assert trajectory.q[-1] == pytest.approx(end, abs=1e-12)
    assert 0.0 < trajectory.duration_s < 0.2
    for order, most in enumerate((ARM.limits.dq_max, ARM.limits.ddq_max, ARM.limits.dddq_max), start=1):
        assert (trajectory.peak(order) <= most).all()


def test_nan_is_refused_with_row_and_joint():
    path = np.linspace(ARM.q_home, ARM.q_home + 0.1, 5)
    path[3, 2] = np.nan
    with pytest.raises(TrajectoryError, match=r"joint index 2: q_path\[3\]"):
        time_law(path, ARM)


def test_wrong_joint_count_is_refused():
    with pytest.raises(TrajectoryError, match="6 joints"):
        time_law(np.linspace(np.zeros(6), np.ones(6), 5), ARM)


def test_a_path_outside_the_position_limits_is_refused():
    end = ARM.q_home.copy()
    end[1] = 2.3
    with pytest.raises(TrajectoryError, match="'joint2'"):
        time_law(np.linspace(ARM.q_home, end, 20), ARM)


def test_a_bridge_to_the_same_posture_is_refused():
    with pytest.raises(TrajectoryError, match="does not move"):
        point_to_point(ARM.q_home, ARM.q_home, ARM)


def test_a_bridge_to_nan_is_refused():
    with pytest.raises(TrajectoryError, match="q1"):
        point_to_point(ARM.q_home, np.full(7, np.nan), ARM)


@pytest.mark.parametrize("value", [0.0, 1.2, -0.5])
def test_shares_outside_zero_to_one_are_refused(value):
    with pytest.raises(ValueError, match="share"):
        TimeLawSettings(share=value)


def test_smoothing_keeps_the_ends_and_its_bound():
    rng = np.random.default_rng(0)
    q = np.cumsum(rng.uniform(-0.05, 0.05, (30, 7)), axis=0)
    path = smooth_path(q, 0.004)
    assert path(0.0) == pytest.approx(q[0], abs=1e-9)
    assert path(path.x[-1]) == pytest.approx(q[-1], abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_long_way_keeps_to_its_corners(seed):
    """Four way-points far apart, as a message of them has: some ten radians of path."""
    limits = ARM.limits
    rng = np.random.default_rng(seed)
    corners = [ARM.q_home, *(rng.uniform(0.6 * limits.q_min, 0.6 * limits.q_max) for _ in range(3))]
    lines = np.concatenate([np.linspace(a, b, 2000) for a, b in pairwise(corners)])
    trajectory = time_law(np.array(corners), ARM)
    q = trajectory.sample(np.linspace(0.0, trajectory.duration_s, 500))[0]
    assert max(np.abs(lines - row).max(axis=1).min() for row in q) < 0.006
    assert max(np.abs(q - corner).max(axis=1).min() for corner in corners[1:-1]) < 0.012


def test_two_points_make_a_straight_path():
    q = np.array([np.zeros(7), np.full(7, 0.2)])
    path = smooth_path(q, 0.004)
    middle = path(path.x[-1] / 2.0)
    assert middle == pytest.approx(np.full(7, 0.1), abs=1e-6)
