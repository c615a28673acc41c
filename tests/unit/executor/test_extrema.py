"""The search for values outside: nothing missed between knots, nothing refused that is inside."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import polynomial

from s2r_executor.extrema import find_exceedance

ZERO = np.zeros(1)


def bernstein_of(power):
    """Bernstein control points of a polynomial given by its power coefficients on [0, 1]."""
    from math import comb

    n = len(power) - 1
    return np.array([sum(comb(i, k) / comb(n, k) * power[k] for k in range(i + 1)) for i in range(n + 1)])


def true_range(power):
    roots = polynomial.polyroots(polynomial.polyder(power))
    inside = roots[(np.abs(roots.imag) < 1e-12) & (roots.real > 0) & (roots.real < 1)].real
    values = polynomial.polyval(np.concatenate([[0.0, 1.0], inside]), power)
    return values.min(), values.max()


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_limits_just_outside_the_range_pass_and_just_inside_are_found(degree):
    rng = np.random.default_rng(degree)
    for _ in range(200):
        power = rng.normal(size=degree + 1)
        control = bernstein_of(power)[None, :, None]
        low, high = true_range(power)
        gap = 1e-9 * (1 + abs(high) + abs(low))
        assert find_exceedance(control, np.array([low - gap]), np.array([high + gap]), ZERO) is None
        above = find_exceedance(control, np.array([low - 1.0]), np.array([high - gap]), ZERO)
        assert above is not None
        assert above.value == pytest.approx(high, abs=1e-9 * (1 + abs(high)))
        assert find_exceedance(control, np.array([low + gap]), np.array([high + 1.0]), ZERO) is not None


def test_the_worst_of_many_is_named_with_segment_joint_and_place():
    control = np.zeros((4, 3, 2))
    control[1, 1, 0] = 3.0  # peak 1.5 in the middle
    control[3, 1, 1] = -8.0  # peak -4
    worst = find_exceedance(control, np.full(2, -1.0), np.full(2, 1.0), np.zeros(2))
    assert (worst.segment, worst.joint) == (3, 1)
    assert worst.fraction == pytest.approx(0.5)
    assert worst.value == pytest.approx(-4.0)
    assert worst.limit == -1.0


def test_not_a_number_counts_as_outside():
    control = np.zeros((1, 4, 1))
    control[0, 2, 0] = np.nan
    assert find_exceedance(control, np.array([-1.0]), np.array([1.0]), ZERO) is not None


def test_a_plan_that_rides_its_limit_is_accepted_within_the_tolerance():
    control = np.full((100, 5, 1), 1.0) + np.random.default_rng(0).normal(scale=1e-12, size=(100, 5, 1))
    assert find_exceedance(control, np.array([-1.0]), np.array([1.0]), np.array([1e-9])) is None
