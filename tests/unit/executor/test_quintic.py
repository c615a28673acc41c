"""Splines: knots are met, derivatives agree with each other, control points enclose the curve."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_executor.quintic import control_points, sample, spline_through


def random_spline(seed, n=8, dof=3):
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.5, n - 1))])
    return spline_through(t, *rng.normal(size=(3, n, dof)))


@pytest.mark.parametrize("seed", range(5))
def test_spline_meets_its_knots_from_both_sides(seed):
    spline = random_spline(seed)
    before = sample(spline, spline.t[1:] - 1e-12)
    after = sample(spline, spline.t)
    np.testing.assert_allclose(after.q, spline.q, atol=1e-9)
    np.testing.assert_allclose(before.q, spline.q[1:], atol=1e-9)
    np.testing.assert_allclose(after.dq[:-1], spline.dq[:-1], atol=1e-9)
    np.testing.assert_allclose(before.ddq, spline.ddq[1:], atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_each_derivative_is_the_slope_of_the_one_below(seed):
    spline = random_spline(seed)
    t = np.linspace(0.01, spline.duration_s - 0.01, 101)
    t = t[np.abs(t[:, None] - spline.t).min(axis=1) > 1e-4]
    h = 1e-6
    low, mid, high = (sample(spline, t + d) for d in (-h, 0.0, h))
    for below, above in (("q", "dq"), ("dq", "ddq"), ("ddq", "dddq")):
        slope = (getattr(high, below) - getattr(low, below)) / (2 * h)
        scale = np.abs(getattr(mid, above)).max()
        np.testing.assert_allclose(slope, getattr(mid, above), atol=1e-5 * scale + 1e-4)


@pytest.mark.parametrize("seed", range(10))
def test_control_points_enclose_the_curve_and_end_on_it(seed):
    spline = random_spline(seed)
    for level, control in zip(("q", "dq", "ddq", "dddq"), control_points(spline), strict=True):
        for k in range(len(spline.t) - 1):
            inside = np.linspace(spline.t[k], spline.t[k + 1], 50)[1:-1]
            values = getattr(sample(spline, inside), level)
            slack = 1e-9 * (1 + np.abs(control[k]).max())
            assert (values <= control[k].max(axis=0) + slack).all()
            assert (values >= control[k].min(axis=0) - slack).all()
    position, velocity, acceleration, _ = control_points(spline)
    np.testing.assert_array_equal(position[:, 0], spline.q[:-1])
    np.testing.assert_allclose(velocity[:, 0], spline.dq[:-1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(acceleration[:, -1], spline.ddq[1:], rtol=1e-6, atol=1e-6)
