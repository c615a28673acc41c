"""Commanded motions: slow ramps, small reversals, several sines, point-to-point moves, in drawn order.

Positions are built from quintic blends and windowed sines, so speed and acceleration are continuous.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

RATE_HZ = 1000.0
DURATION_S = 20.0


def _blend(x: np.ndarray) -> np.ndarray:
    """Quintic step 0 → 1 with zero speed and acceleration at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def _through(points: list[tuple[float, float]], t: np.ndarray) -> np.ndarray:
    """Quintic moves through (time [s], position) pairs; equal neighbours are dwells."""
    q = np.full_like(t, points[0][1])
    for (t0, q0), (t1, q1) in pairwise(points):
        q = np.where(t >= t0, q0 + (q1 - q0) * _blend((t - t0) / (t1 - t0)), q)
    return q


def _ramps(rng: np.random.Generator, t: np.ndarray, length_s: float) -> np.ndarray:
    """Slow passes there and back with nearly constant speed."""
    top, bottom = rng.uniform(0.35, 0.8), -rng.uniform(0.35, 0.8)
    phase = np.clip(t / length_s, 0.0, 1.0)
    knots = np.array([0.0, 0.25, 0.75, 1.0])
    triangle = np.interp(phase, knots, [0.0, top, bottom, 0.0])
    window = max(3, int(0.3 * RATE_HZ))
    kernel = np.hanning(window)
    padded = np.pad(triangle, (window, window), mode="edge")
    smooth = np.convolve(padded, kernel / kernel.sum(), mode="same")[window:-window]
    return smooth * _blend(t / 0.5) * _blend((length_s - t) / 0.5)


def _sines(rng: np.random.Generator, t: np.ndarray, length_s: float) -> np.ndarray:
    """Four to six sines between 0.15 and 2.5 Hz, peak below one."""
    count = int(rng.integers(4, 7))
    frequencies = np.exp(rng.uniform(np.log(0.15), np.log(2.5), count))
    amplitudes = rng.uniform(0.4, 1.0, count) / np.maximum(frequencies, 0.3)
    phases = rng.uniform(0.0, 2.0 * np.pi, count)
    wave = (amplitudes[:, None] * np.sin(2 * np.pi * frequencies[:, None] * t + phases[:, None])).sum(0)
    inside = (t >= 0.0) & (t <= length_s)
    peak = np.abs(wave[inside]).max() if inside.any() else 1.0
    return 0.9 * wave / peak * _blend(t / 0.8) * _blend((length_s - t) / 0.8)


def _moves(rng: np.random.Generator, t: np.ndarray, length_s: float) -> np.ndarray:
    """Point-to-point moves with dwells, returning to the centre."""
    points, now, here = [(0.0, 0.0)], 0.0, 0.0
    while now < length_s - 1.6:
        there = rng.uniform(-0.95, 0.95)
        move_s = rng.uniform(0.45, 1.0) * (0.6 + 0.8 * abs(there - here))
        points += [(now + move_s, there), (now + move_s + rng.uniform(0.1, 0.4), there)]
        now, here = points[-1][0], there
    points.append((max(length_s, now + 0.8), 0.0))
    return _through(points, t * points[-1][0] / length_s)


def _small(rng: np.random.Generator, t: np.ndarray, length_s: float) -> np.ndarray:
    """Reversals of growing amplitude about a drawn place: what presliding, hysteresis and play need."""
    place = rng.uniform(-0.5, 0.5)
    frequency = rng.uniform(0.5, 0.9)
    growth = np.exp(np.log(0.01) + np.clip(t / length_s, 0.0, 1.0) * (np.log(0.25) - np.log(0.01)))
    inside = _blend(t / 0.8) * _blend((length_s - t) / 0.8)
    return inside * (place + growth * np.sin(2 * np.pi * frequency * t))


_PARTS = (_ramps, _sines, _moves, _small)


def rich(rng: np.random.Generator, duration_s: float = DURATION_S) -> np.ndarray:
    """One joint's motion in [−1, 1] that excites everything, shape (ticks,)."""
    t = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    lengths = (duration_s - 0.6) * rng.dirichlet([14.0, 16.0, 16.0, 10.0])
    q = np.zeros_like(t)
    start = 0.3
    for k in rng.permutation(len(_PARTS)):
        local = t - start
        inside = (local >= 0.0) & (local < lengths[k])
        part = _PARTS[k](rng, np.clip(local, 0.0, lengths[k]), lengths[k])
        q[inside] += part[inside]
        start += lengths[k]
    return q


def poor(rng: np.random.Generator, kind: str, duration_s: float = DURATION_S) -> np.ndarray:
    """A motion that cannot show most effects, shape (ticks,): ``still``, ``one_way`` or ``crawl``."""
    t = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    if kind == "still":
        return np.full_like(t, rng.uniform(-0.3, 0.3))
    if kind == "one_way":
        a, b = rng.uniform(-0.9, -0.5), rng.uniform(0.5, 0.9)
        return _through([(0.0, a), (duration_s - 0.5, b), (duration_s, b)], t)
    return rng.uniform(-0.3, 0.3) + 0.004 * np.sin(2 * np.pi * rng.uniform(0.05, 0.1) * t)


def derivatives(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed [rad/s] and acceleration [rad/s²] by central differences along axis 0."""
    dq = np.gradient(q, 1.0 / RATE_HZ, axis=0)
    return dq, np.gradient(dq, 1.0 / RATE_HZ, axis=0)
