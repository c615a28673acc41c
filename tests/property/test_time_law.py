"""Time laws over random paths: inside the limits between knots too, at rest at the ends, near the path."""

import itertools

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from s2r_host.trajectory import TimeLawSettings, time_law
from s2r_host.trajectory.torque import InverseDynamics
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
DENSE = 4001


def random_path(seed: int) -> np.ndarray:
    """Targets as a planner makes them: bounded steps, noisy, ending with a held target."""
    rng = np.random.default_rng(seed)
    steps = gaussian_filter1d(
        rng.uniform(-0.05, 0.05, (rng.integers(4, 50), 7)), rng.uniform(0.1, 2.0), axis=0
    )
    q = np.clip(ARM.q_home + np.cumsum(steps, axis=0), ARM.limits.q_min + 0.05, ARM.limits.q_max - 0.05)
    return np.concatenate([ARM.q_home[None], q, np.repeat(q[-1:], rng.integers(0, 11), axis=0)])


def assert_within_limits(trajectory, share=1.0, torque_share=1.0):
    limits = ARM.limits
    q, dq, ddq = trajectory.sample(np.linspace(0.0, trajectory.duration_s, DENSE))
    jerk = np.abs(np.diff(ddq, axis=0)) / (trajectory.duration_s / (DENSE - 1))
    assert (q >= limits.q_min).all()
    assert (q <= limits.q_max).all()
    assert (np.abs(dq) <= share * limits.dq_max).all()
    assert (np.abs(ddq) <= share * limits.ddq_max).all()
    assert (jerk <= share * limits.dddq_max).all()
    tau = InverseDynamics(ARM).along(q[::20], dq[::20], ddq[::20])
    assert (np.abs(tau) <= torque_share * limits.tau_max).all()


def assert_at_rest_at_both_ends(trajectory, start, end):
    assert trajectory.q[0] == pytest.approx(start, abs=1e-9)
    assert trajectory.q[-1] == pytest.approx(end, abs=1e-9)
    for values in (trajectory.dq, trajectory.ddq):
        assert not values[[0, -1]].any()


def distance_to_polyline(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Largest joint deviation of each point from the nearest place on the straight lines through the path."""
    fine = np.concatenate([np.linspace(a, b, 40) for a, b in itertools.pairwise(path)])
    return np.array([np.abs(fine - p).max(axis=1).min() for p in points])


@pytest.mark.parametrize("seed", range(12))
def test_timed_path_obeys_every_limit_and_stays_near_the_targets(seed):
    path = random_path(seed)
    contact_row = None if seed % 2 else len(path) // 2
    trajectory = time_law(path, ARM, contact_row=contact_row)
    assert_within_limits(trajectory, 0.96, 0.91)
    assert_at_rest_at_both_ends(trajectory, path[0], path[-1])
    assert len(trajectory.t) <= 400
    assert (np.diff(trajectory.t) > 0.0).all()
    q = trajectory.sample(np.linspace(0.0, trajectory.duration_s, 150))[0]
    # 4 mrad of smoothing, plus the spline's way round the corners of the smoothed points.
    assert distance_to_polyline(q, path).max() < 0.006


def test_half_speed_takes_twice_the_time():
    path = random_path(3)
    full, half = (time_law(path, ARM, TimeLawSettings(speed=speed)) for speed in (1.0, 0.5))
    assert half.duration_s == pytest.approx(2.0 * full.duration_s)


@pytest.mark.parametrize("seed", range(3))
def test_fingertip_moves_the_part_no_faster_than_told(seed):
    path = random_path(seed)
    settings = TimeLawSettings(contact_speed_m_s=0.05)
    trajectory = time_law(path, ARM, settings, contact_row=0)
    times = np.linspace(0.0, trajectory.duration_s, 1000)
    tip = InverseDynamics(ARM).tool_positions(trajectory.sample(times)[0])
    speed = np.linalg.norm(np.diff(tip, axis=0), axis=1) / (times[1] - times[0])
    assert speed.max() < 0.0502  # what is looked at in between is four moments per segment
