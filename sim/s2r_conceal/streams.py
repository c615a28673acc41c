"""Random streams of a set: every use has one of its own, whatever the seed.

The purpose stands first and says how many words follow. Without it noise could be the very numbers that its case was
drawn from: numpy fills short seeds up with zeros, so that (seed, case) and (seed, case, 0) are one stream.
"""

from __future__ import annotations

from enum import IntEnum, unique

import numpy as np


@unique
class Purpose(IntEnum):
    """What a stream is for, and which words follow the seed of the set."""

    PLANS = 1  # none
    CASE = 2  # case, attempt
    ARM_LOG = 3  # case, attempt
    FILE = 4  # case, attempt
    NOISE = 5  # case, attempt, recording
    FLOOR_NOISE = 6  # case, attempt, run
    ROWS = 7  # case, attempt, recording


def words(purpose: Purpose, seed: tuple[int, ...], *more: int) -> tuple[int, ...]:
    """What seeds one stream."""
    return (int(purpose), *seed, *more)


def stream(purpose: Purpose, seed: tuple[int, ...], *more: int) -> np.random.Generator:
    """The stream itself."""
    return np.random.default_rng(words(purpose, seed, *more))
