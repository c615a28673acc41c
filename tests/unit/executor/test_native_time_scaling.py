"""The rate ramp that plays on-path stops, pauses and speed changes."""

from __future__ import annotations

import numpy as np
import pytest

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")

DT = 1e-3


def smooth(x: np.ndarray) -> np.ndarray:
    return 6 * x**5 - 15 * x**4 + 10 * x**3


@pytest.mark.parametrize(("start", "target"), [(1.0, 0.0), (0.3, 0.0), (0.0, 1.0), (1.0, 0.4)])
def test_steady_rate_changes_along_the_smoothest_step(start, target):
    rate, rate_dot, distance = _native.rate_ramp(start, [(0, target, 0.2)], DT, 260)
    x = np.minimum(np.arange(1, 261) * DT / 0.2, 1.0)
    assert np.abs(rate - (start + (target - start) * smooth(x))).max() < 1e-12
    assert np.abs(rate_dot - (target - start) * 30 * x**2 * (1 - x) ** 2 / 0.2).max() < 1e-9
    ramp_distance = 0.2 * (start + target) / 2
    assert distance[-1] == pytest.approx(ramp_distance + 0.06 * target, abs=1e-12)


def test_path_time_is_the_exact_integral_of_the_rate():
    rate, _, distance = _native.rate_ramp(1.0, [(10, 0.0, 0.3), (500, 0.7, 0.2)], DT, 900)
    fine_rate, _, _ = _native.rate_ramp(1.0, [(100, 0.0, 0.3), (5000, 0.7, 0.2)], DT / 10, 9000)
    integral = np.cumsum((np.r_[1.0, fine_rate[:-1]] + fine_rate) / 2) * DT / 10
    assert np.abs(distance - integral[9::10]).max() < 1e-7
    assert rate[-1] == 0.7


def test_standing_still_is_exactly_zero():
    rate, rate_dot, distance = _native.rate_ramp(0.8, [(3, 0.0, 0.1234)], DT, 400)
    assert (rate[200:] == 0.0).all()
    assert (rate_dot[200:] == 0.0).all()
    assert (np.diff(distance[200:]) == 0.0).all()


def test_change_under_way_may_be_changed_without_a_step():
    rng = np.random.default_rng(11)
    changes = [
        (int(tick), float(rng.choice([0.0, 1.0, rng.uniform(0.1, 1.0)])), 0.2) for tick in range(0, 3000, 37)
    ]
    rate, rate_dot, _ = _native.rate_ramp(1.0, changes, DT, 4000)
    peak_slope, peak_curvature = 15 / 8 / 0.2, 10 / np.sqrt(3) / 0.2**2
    assert rate.min() >= -1e-12
    assert rate.max() <= 1.0 + 1e-12
    assert np.abs(rate_dot).max() <= peak_slope * (1 + 1e-9)
    assert np.abs(np.diff(rate_dot)).max() / DT <= peak_curvature * (1 + 1e-9)
    slope_error = np.diff(rate) / DT - (rate_dot[1:] + rate_dot[:-1]) / 2
    assert np.abs(slope_error).max() <= peak_curvature * DT / 4 * (1 + 1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_a_change_under_way_that_gets_a_longer_ramp_goes_beyond_neither_target(seed):
    """A stop during a resume: its segment may need three times as long as the one in which the resume began."""
    rng = np.random.default_rng([12, seed])
    durations = rng.choice([0.05, 0.1, 0.2, 0.6], size=60)
    ticks = np.cumsum(rng.integers(3, 120, size=60))
    targets = rng.choice([0.0, 1.0, 0.3], size=60)
    rate, rate_dot, _ = _native.rate_ramp(
        1.0, list(zip(ticks.tolist(), targets.tolist(), durations.tolist(), strict=True)), DT, 8000
    )
    assert rate.min() >= -1e-9
    assert rate.max() <= 1.0 + 1e-9
    assert rate[-1] == targets[-1]
    peak_slope, peak_curvature = 15 / 8 / 0.05, 10 / np.sqrt(3) / 0.05**2
    assert np.abs(rate_dot).max() <= peak_slope * (1 + 1e-9)
    assert np.abs(np.diff(rate_dot)).max() / DT <= peak_curvature * (1 + 1e-9)


def test_a_stop_during_a_resume_slows_down_from_where_it_is():
    rate, _, _ = _native.rate_ramp(0.0, [(0, 1.0, 0.2), (100, 0.0, 0.6)], DT, 1500)
    assert rate[99] == pytest.approx(0.5)
    assert rate.max() <= 1.0  # the slope that was under way, brought down as the resume would have
    assert (rate[900:] == 0.0).all()


def test_change_to_the_present_target_goes_on_undisturbed():
    once = _native.rate_ramp(1.0, [(0, 0.0, 0.2)], DT, 300)
    again = _native.rate_ramp(1.0, [(0, 0.0, 0.2), (60, 0.0, 0.2), (250, 0.0, 0.2)], DT, 300)
    for a, b in zip(once, again, strict=True):
        assert (a == b).all()
