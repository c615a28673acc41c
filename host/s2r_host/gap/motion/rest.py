"""Where a joint may stick, and where it rests for long."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.time_spans import runs

REST_S = 0.2  # longer than a joint takes to turn round
STOPPING_S = 0.06  # of the way in and out of a rest
REST_NOISES = 3.0  # of the speed: a joint that a simulator holds creeps


def rests_of(s: Session, j: int) -> np.ndarray:
    """Where a joint stays still for longer than it takes to turn round, stopping and starting included, shape (time,).

    Stops and starts are blurred by the filters, and a joint that is about to stick does not slide as others do.
    """
    rests = np.zeros(len(s.t), dtype=bool)
    for start, end in stands(s, j):
        if (end - start) * s.dt > REST_S:
            rests[start:end] = True
    reach = round((min(1.0 / float(s.cut[j]), STOPPING_S) + 0.25 * REST_S) / s.dt)
    return maximum_filter1d(rests, 2 * reach + 1)


def stands(s: Session, j: int) -> np.ndarray:
    """Where a joint does not move, however shortly: first row and the one after the last, shape (runs, 2)."""
    # The noise of the speed crosses any bound now and then: it does not end a rest.
    mean_square = uniform_filter1d(s.v[:, j] ** 2, max(1, round(0.5 * REST_S / s.dt)), mode="nearest")
    return runs(mean_square < (REST_NOISES * s.v_noise[j]) ** 2)


def stillness(s: Session, j: int) -> np.ndarray:
    """One where a joint may stick, zero where it clearly moves, shape (time,)."""
    return 1.0 - np.tanh(s.slip(j) / (2.0 * s.v_eps[j])) ** 2
