"""Coloured noise: variance, spectrum, knots."""

import numpy as np
import pytest

from s2r_host.planning.noise import coloured_noise, on_knots


@pytest.mark.parametrize("beta", [0.0, 1.0, 2.5, 4.0])
@pytest.mark.parametrize("length", [3, 10, 11])
def test_noise_has_unit_variance_for_every_colour(beta, length):
    noise = coloured_noise(np.random.default_rng(1), (4000, length, 2), beta)
    assert noise.shape == (4000, length, 2)
    assert np.isclose(noise.var(), 1.0, atol=0.05)
    assert np.abs(noise.mean()) < 0.05


@pytest.mark.parametrize("beta", [0.0, 1.0, 2.5])
def test_power_falls_with_frequency_as_the_colour_says(beta):
    noise = coloured_noise(np.random.default_rng(2), (3000, 64, 1), beta)[..., 0]
    power = (np.abs(np.fft.rfft(noise, axis=1)) ** 2).mean(axis=0)[1:-1]
    frequency = np.fft.rfftfreq(64)[1:-1]
    slope = np.polyfit(np.log(frequency), np.log(power), 1)[0]
    assert slope == pytest.approx(-beta, abs=0.1)


def test_same_generator_state_gives_the_same_noise():
    first, second = (coloured_noise(np.random.default_rng(3), (5, 10, 7), 2.5) for _ in range(2))
    assert np.array_equal(first, second)


def test_knots_are_hit_and_joined_by_straight_lines():
    knots = np.array([[[0.0], [1.0], [-1.0]]])
    stretched = on_knots(knots, 11)[0, :, 0]
    assert stretched[[0, 5, 10]] == pytest.approx([0.0, 1.0, -1.0])
    assert np.diff(stretched, 2)[[0, 1, 2, 5, 6, 7]] == pytest.approx(0.0, abs=1e-12)


def test_noise_on_knots_is_straight_between_them_and_has_unit_variance_there():
    noise = coloured_noise(np.random.default_rng(4), (4000, 11, 2), 2.5, knots=3)
    assert noise.shape == (4000, 11, 2)
    assert noise[:, [0, 5, 10]].var(axis=(0, 2)) == pytest.approx(1.0, abs=0.06)
    assert np.diff(noise, 2, axis=1)[:, [0, 1, 2, 3, 5, 6, 7, 8]] == pytest.approx(0.0, abs=1e-12)
