"""Coloured noise: random sequences whose power falls with frequency as 1/f^beta."""

from __future__ import annotations

import functools

import numpy as np


def coloured_noise(rng: np.random.Generator, shape: tuple[int, int, int], beta: float) -> np.ndarray:
    """Gaussian noise of unit variance, coloured along time (Timmer and König, Astron. Astrophys. 300, 1995).

    Args:
        rng: Source of randomness.
        shape: (samples, time, dof).
        beta: Exponent of the power spectrum; 0 is white, 1 pink, 2 a random walk.

    Returns:
        Array of the given shape. The zero frequency gets the power of the lowest one, so a sample may be a
        constant push: that is what makes coloured noise reach farther than white noise of the same variance.
    """
    samples, length, dof = shape
    if length == 1:
        return rng.standard_normal(shape)
    amplitude, deviation = _spectrum(length, beta)
    real = rng.standard_normal((samples, dof, len(amplitude)))
    imaginary = rng.standard_normal((samples, dof, len(amplitude)))
    imaginary[..., 0] = 0.0
    real[..., 0] *= np.sqrt(2.0)
    if length % 2 == 0:
        imaginary[..., -1] = 0.0
        real[..., -1] *= np.sqrt(2.0)
    spectrum = amplitude * (real + 1j * imaginary)
    return np.swapaxes(np.fft.irfft(spectrum, n=length, axis=-1), 1, 2) / deviation


@functools.cache
def _spectrum(length: int, beta: float) -> tuple[np.ndarray, float]:
    """Amplitude of every frequency, and the standard deviation of the sum."""
    frequency = np.fft.rfftfreq(length)
    frequency[0] = frequency[1]
    amplitude = frequency ** (-beta / 2.0)
    # Variance of the inverse transform: every bin but the real ones counts twice.
    counts = np.full(len(frequency), 2.0)
    counts[0] = 1.0
    if length % 2 == 0:
        counts[-1] = 1.0
    return amplitude, float(np.sqrt(2.0 * np.sum(counts * amplitude**2)) / length)


def on_knots(values: np.ndarray, horizon: int) -> np.ndarray:
    """Stretch knot values, shape (samples, knots, dof), linearly over ``horizon`` steps: (samples, horizon, dof)."""
    left, share = _between(values.shape[1], horizon)
    return (1.0 - share) * values[:, left] + share * values[:, left + 1]


@functools.cache
def _between(knots: int, horizon: int) -> tuple[np.ndarray, np.ndarray]:
    """The knot before every step, (horizon,), and the share of the way to the next one, (1, horizon, 1)."""
    place = np.linspace(0.0, knots - 1.0, horizon)
    left = np.minimum(place.astype(int), knots - 2)
    return left, (place - left)[None, :, None]
