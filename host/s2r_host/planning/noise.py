"""Coloured noise: random sequences whose power falls with frequency as 1/f^beta."""

from __future__ import annotations

import functools

import numpy as np


def coloured_noise(
    rng: np.random.Generator, shape: tuple[int, int, int], beta: float, knots: int | None = None
) -> np.ndarray:
    """Gaussian noise of unit variance, coloured along time (Timmer and König, Astron. Astrophys. 300, 1995).

    Args:
        rng: Source of randomness.
        shape: (samples, time, dof).
        beta: Exponent of the power spectrum; 0 is white, 1 pink, 2 a random walk.
        knots: Draw it on so many knots and join them by straight lines; None: one value per time.

    Returns:
        Array of the given shape. The zero frequency gets the power of the lowest one, so a sample may be a
        constant push: that is what makes coloured noise reach farther than white noise of the same variance.
    """
    samples, length, dof = shape
    colours = _colours(knots or length, beta, length)
    white = rng.standard_normal((samples * dof, len(colours)))
    return (white @ colours).reshape(samples, dof, length).swapaxes(1, 2)


@functools.cache
def _colours(count: int, beta: float, length: int) -> np.ndarray:
    """What white noise is multiplied with: ``count`` coloured values, stretched to ``length``, (count, length)."""
    if count == 1:
        return np.ones((1, length))
    frequency = np.fft.rfftfreq(count)
    frequency[0] = frequency[1]
    # One white number for every cosine and sine: frequency zero has no sine, nor has the highest of an even count.
    cosines, sines = np.arange(len(frequency)), np.arange(1, (count + 1) // 2)
    waves = np.zeros((count, len(frequency)), dtype=complex)
    waves[cosines, cosines] = 1.0
    waves[len(cosines) + sines - 1, sines] = 1.0j
    # The inverse transform counts every frequency twice but those two.
    waves[0] *= np.sqrt(2.0)
    if count % 2 == 0:
        waves[cosines[-1]] *= np.sqrt(2.0)
    colours = np.fft.irfft(waves * frequency ** (-beta / 2.0), n=count)
    colours /= np.sqrt((colours**2).sum(axis=0).mean())
    return on_knots(colours[..., None], length)[..., 0] if length != count else colours


def on_knots(values: np.ndarray, horizon: int) -> np.ndarray:
    """Stretch knot values, shape (samples, knots, dof), linearly over ``horizon`` steps: (samples, horizon, dof)."""
    knots = values.shape[1]
    place = np.linspace(0.0, knots - 1.0, horizon)
    left = np.minimum(place.astype(int), knots - 2)
    share = (place - left)[None, :, None]
    return (1.0 - share) * values[:, left] + share * values[:, left + 1]
