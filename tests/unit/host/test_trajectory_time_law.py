"""What the time law and the bridge refuse, and in which words."""

from itertools import pairwise

import numpy as np
import pytest

from s2r_host.trajectory import TimeLawSettings, Trajectory, TrajectoryError, time_law
from s2r_host.trajectory.path import smooth_path
from s2r_host.trajectory.time_law import limit_stretch
from s2r_host.trajectory.to_rest import to_rest
from s2r_host.trajectory.torque import InverseDynamics, torque_stretch
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
DYNAMICS = InverseDynamics(ARM)


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


def largest_torque(trajectory: Trajectory) -> float:
    """Largest share of a torque limit, at places ten times as close as admission looks."""
    times = np.union1d(
        trajectory.t, np.linspace(0.0, trajectory.duration_s, int(1e3 * trajectory.duration_s))
    )
    return float((np.abs(DYNAMICS.along(*trajectory.sample(times))) / ARM.limits.tau_max).max())


@pytest.mark.parametrize("seed", range(6))
def test_torques_stay_within_their_share_between_knots_that_are_far_apart(seed):
    rng = np.random.default_rng([5, seed])
    low, high = ARM.limits.q_min + 0.05, ARM.limits.q_max - 0.05
    q = np.clip(ARM.q_home + rng.normal(scale=0.6, size=(2, ARM.dof)), low, high)
    line = Trajectory(np.array([0.0, 1.0]), q, np.zeros_like(q), np.zeros_like(q))
    motion = line.stretched(limit_stretch(line, ARM, 2.0))  # so fast that it is not all weight
    holding = largest_torque(motion.stretched(100.0))
    share = 0.3 * largest_torque(motion) + 0.7 * holding  # so little that the motion has to be slowed
    slowed = motion.stretched(torque_stretch(motion, ARM, DYNAMICS, share))
    assert slowed.duration_s > motion.duration_s
    assert largest_torque(slowed) <= 1.0005 * share


def test_a_motion_to_rest_is_refused_for_the_torque_of_any_of_its_knots():
    start = (
        ARM.q_home,
        np.array([0.4, -0.4, 0.3, 0.5, 0.0, 0.3, 0.2]),
        np.array([3.0, 2.0, -3.0, 2.0, 0.0, 0.0, 0.0]),
    )
    goal = ARM.q_home + 0.2
    motion = to_rest(start, goal, ARM, 0.5)
    share = (np.abs(DYNAMICS.along(motion.q, motion.dq, motion.ddq)) / ARM.limits.tau_max).max()
    assert to_rest(start, goal, ARM, 0.5, DYNAMICS, share + 1e-9).duration_s == motion.duration_s
    with pytest.raises(TrajectoryError, match="of its torque"):
        to_rest(start, goal, ARM, 0.5, DYNAMICS, share - 1e-9)
