"""Quintic Hermite segments against the definition."""

from __future__ import annotations

import numpy as np
import pytest

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")


@pytest.fixture
def random_spline():
    rng = np.random.default_rng(3)
    t = np.cumsum(np.r_[0.0, rng.uniform(0.05, 0.7, 9)])
    return t, rng.normal(size=(10, 4)), rng.normal(size=(10, 4)), rng.normal(size=(10, 4))


def test_knots_are_met_in_position_velocity_and_acceleration(random_spline):
    t, q, dq, ddq = random_spline
    for values, expected in zip(_native.evaluate_spline(*random_spline, t), (q, dq, ddq), strict=False):
        assert np.abs(values - expected).max() < 1e-9


def test_both_sides_of_a_knot_agree(random_spline):
    t = random_spline[0][1:-1]
    before = _native.evaluate_spline(*random_spline, t - 1e-9)
    after = _native.evaluate_spline(*random_spline, t + 1e-9)
    for left, right in zip(before[:3], after[:3], strict=True):
        assert np.abs(left - right).max() < 1e-3  # jerk reaches 1e5 here


def test_derivatives_are_those_of_the_position(random_spline):
    t = random_spline[0]
    rng = np.random.default_rng(4)
    s = rng.uniform(0.0, t[-1], 200)
    s = s[np.abs(s[:, None] - t).min(axis=1) > 1e-3]
    h = 1e-5
    low, mid, high = (_native.evaluate_spline(*random_spline, s + d) for d in (-h, 0.0, h))
    for order in range(3):
        slope = (high[order] - low[order]) / (2 * h)
        scale = np.abs(mid[order + 1]).max()
        assert np.abs(slope - mid[order + 1]).max() < 1e-6 * scale


def test_a_quintic_is_reproduced_exactly():
    c = np.array([0.3, -0.2, 0.5, 1.0, -0.7, 0.2])
    t = np.array([0.0, 0.4, 1.3])
    polynomial = np.polynomial.Polynomial(c)
    knots = [
        np.array([d(x) for x in t])[:, None] for d in (polynomial, polynomial.deriv(), polynomial.deriv(2))
    ]
    s = np.linspace(0.0, 1.3, 50)
    values = _native.evaluate_spline(t, *knots, s)
    for order in range(4):
        expected = polynomial.deriv(order)(s) if order else polynomial(s)
        assert np.abs(values[order][:, 0] - expected).max() < 1e-11


def test_times_outside_the_plan_give_its_ends(random_spline):
    t, q, _, _ = random_spline
    values = _native.evaluate_spline(*random_spline, np.array([-1.0, t[-1] + 1.0]))[0]
    assert np.abs(values - q[[0, -1]]).max() < 1e-12


def test_order_of_the_times_does_not_matter(random_spline):
    s = np.random.default_rng(5).uniform(0.0, random_spline[0][-1], 100)
    shuffled = _native.evaluate_spline(*random_spline, s)[0]
    ordered = _native.evaluate_spline(*random_spline, np.sort(s))[0]
    assert (shuffled[np.argsort(s)] == ordered).all()
