"""Objects for training, validation and test that never meet: the split is part of the seed."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from s2r_sim.objects.catalogue import KINDS, ObjectSpec, kind_named

GENERATOR = 1  # raise it when a change of any kind's distribution must not be mixed with older data


class Split(IntEnum):
    """What an object may be used for; the number enters the seed."""

    TRAIN = 0
    VALIDATION = 1
    TEST = 2


def split_rng(kind: str, split: Split, seed: int) -> np.random.Generator:
    """The random numbers of one object: other kinds, splits and seeds share nothing with it."""
    return np.random.default_rng([GENERATOR, list(KINDS).index(kind), int(split), seed])


def draw_object(kind: str, split: Split, seed: int) -> ObjectSpec:
    """Draw the object with this number.

    Raises:
        WorldFileError: Unknown kind.
    """
    return kind_named(kind).draw(split_rng(kind, split, seed))
