"""Intervals of shapes that pull against each other, and of coefficients that follow them."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.gap.regression.solution import Term
from s2r_host.gap.verdict.intervals import curvature, shape_spread

BEST = np.array([2.0, 5.0])
PRECISION = np.array([[120.0, 90.0], [90.0, 80.0]])
SLOPE = np.array([[0.5, -2.0]])


class Ridge:
    """Evidence that is a tilted ridge over two shapes; the coefficient slides along with them."""

    def __init__(self) -> None:
        self.problem = SimpleNamespace(held=np.zeros(3, dtype=bool), ctx=None)
        steps = {"limit": ("log", 0.05), "v0": ("log", 0.05)}
        self.effects = {"clip": SimpleNamespace(refine=lambda ctx, joint: steps)}

    def marginal(self, others, rows, noise):
        return None

    def weigh(self, base, rows, term):
        shape = dict(term.shape)
        x = np.array([shape["limit"], shape["v0"]]) - BEST
        evidence = -0.5 * float(x @ PRECISION @ x)
        return SimpleNamespace(log_evidence=lambda noise, prior: evidence, theta=1.0 + SLOPE @ x), np.ones(1)


def spread():
    return shape_spread(Ridge(), Term("clip", 0, (("limit", BEST[0]), ("v0", BEST[1]))), [], 1.0)


def test_two_shapes_that_trade_off_get_the_width_of_the_ridge():
    found = spread()
    assert found.keys == ("limit", "v0")
    np.testing.assert_allclose(found.covariance, np.linalg.inv(PRECISION), rtol=0.02)


def test_a_coefficient_follows_the_shapes():
    np.testing.assert_allclose(spread().slopes, SLOPE, rtol=1e-6)


def test_the_width_of_one_shape_comes_from_its_profile():
    deviation, flat = curvature(lambda h: -0.5 * (h / 0.3) ** 2, 0.0, 2.0, 1.0, "linear", 5.0)
    assert deviation == pytest.approx(0.3, rel=1e-6)
    assert not flat


def test_a_shape_that_changes_nothing_measurable_is_flat():
    assert curvature(lambda h: -1e-5 * h**2, 0.0, 0.2, 1.0, "log", 1.0)[1]


def test_evidence_that_jumps_is_as_wide_as_the_jump_and_no_wider():
    """Flat to 0.1 either way, then a cliff: a width far beyond it would carry a positive shape below zero."""
    deviation, flat = curvature(lambda h: -1e-5 if abs(h) < 0.1 else -100.0, 0.0, 0.2, 1.0, "log", 1.0)
    assert 0.005 < deviation < 0.2
    assert not flat
