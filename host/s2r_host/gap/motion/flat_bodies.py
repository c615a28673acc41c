"""Moments of inertia that MuJoCo takes, of flat and thin bodies, too.

It refuses moments of which one is more than the sum of the others. Of a disc or a rod they are equal, and what the last
digit is rounded to decides.
"""

from __future__ import annotations

import numpy as np

EXACT = 1e-9  # share of the largest moment that covers the last digit of a computed number
WRITTEN = 2e-5  # twice what the six digits that MuJoCo writes may add up to in three moments


def thickened(moments: np.ndarray, share: float) -> np.ndarray:
    """Principal moments, shape (3,); of a body that is flat or thin the smallest with a share of the largest added."""
    largest = float(moments.max())
    if float(moments.sum()) - 2.0 * largest > share * largest:
        return moments
    return moments + share * largest * (moments == moments.min())
