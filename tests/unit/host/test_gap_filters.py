"""Zero-phase filters: what scipy's are, and what they refuse."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from s2r_host._native import forward_backward
from s2r_host.gap.motion.filters import zero_phase

DT, CUTS = 0.002, (30.0, 12.0)
PAD = int(3 / (min(CUTS) * DT))


def test_columns_and_a_single_signal_are_filtered_as_scipy_does():
    x = np.random.default_rng(4).normal(size=(700, 3)).cumsum(axis=0)
    sections = np.concatenate([np.asarray(butter(2, c, fs=1 / DT, output="sos")) for c in CUTS])
    expected = sosfiltfilt(sections, x, axis=0, padlen=PAD)
    np.testing.assert_allclose(zero_phase(x, CUTS, DT), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(zero_phase(x[:, 1], CUTS, DT), zero_phase(x, CUTS, DT)[:, 1])


def test_a_record_shorter_than_the_filter_keeps_its_length():
    x = np.random.default_rng(5).normal(size=9)
    assert zero_phase(x, CUTS, DT).shape == (9,)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"pad": 5}, "pad must be less than the rows"),
        ({"pad": -1}, "pad must be less than the rows"),
        ({"x": np.zeros((5, 0))}, "x must have rows and columns"),
        ({"sections": np.zeros((1, 5))}, "six numbers each"),
        ({"sections": np.zeros((1, 6))}, "must be 1"),
        ({"start": np.zeros((2, 2))}, "two numbers per section"),
    ],
)
def test_what_does_not_fit_together_is_refused(changes, text):
    whole = {
        "x": np.zeros((5, 1)),
        "sections": np.array([[1.0, 0, 0, 1, 0, 0]]),
        "start": np.zeros((1, 2)),
        "pad": 1,
    }
    with pytest.raises(ValueError, match=text):
        forward_backward(**(whole | changes))
