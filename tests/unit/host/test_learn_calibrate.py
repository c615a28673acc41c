"""Figures of a trained network on unseen objects."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.learn.calibrate import area_under_curve


@pytest.mark.parametrize(
    ("good", "bad", "area"),
    [
        ([2.0, 3.0], [0.0, 1.0], 1.0),
        ([0.0, 1.0], [2.0, 3.0], 0.0),
        ([1.0, 1.0], [1.0, 1.0, 1.0], 0.5),
        ([1.0], [0.0, 1.0], 0.75),
        ([], [1.0], 0.5),
    ],
)
def test_a_tie_counts_half(good, bad, area):
    """A network that tells every push the same knows nothing: 0.5, not 0."""
    score, truth = np.array([*good, *bad]), np.array([True] * len(good) + [False] * len(bad))
    assert area_under_curve(score, truth) == area
    assert area_under_curve(score[::-1], truth[::-1]) == area


def test_it_is_the_share_of_pairs_that_stand_in_order():
    rng = np.random.default_rng(2)
    score, truth = rng.integers(0, 20, 200).astype(float), rng.random(200) < 0.3
    pairs = score[truth][:, None] - score[~truth]
    assert area_under_curve(score, truth) == pytest.approx(np.mean((pairs > 0) + 0.5 * (pairs == 0)))
