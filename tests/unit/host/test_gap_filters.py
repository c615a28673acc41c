"""Zero-phase filters: what scipy's are, and what they refuse."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from s2r_host._native import forward_backward
from s2r_host.gap.motion.filters import zero_phase
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model

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


def efforts(folder, rate_hz, line_hz):
    """A joint that stands still under 1 N·m, and a line of 0.5 N·m in its effort and in a wrench; on the work grid."""
    t = np.arange(0.0, 8.0, 1.0 / rate_hz)
    hum = 1.0 + 0.5 * np.sin(2.0 * np.pi * line_hz * t)
    channels = {"q": {"elbow": 0.0 * t}, "tau": {"elbow": hum}, "wrench": {"arm.my": hum}}
    rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    session = make_session(RigidModel(write_model(folder / "model.xml")), rec, 0)
    assert session.dt == pytest.approx(0.002)
    inner = slice(100, -100)
    return session.drive(0)[inner], session.pushed[inner, 0]


@pytest.mark.parametrize("rate_hz", [1000, 2000])
def test_a_line_above_the_band_of_the_work_grid_does_not_come_back_below(tmp_path, rate_hz):
    """492 Hz, taken as every second row of 1000, is 8 Hz, and was told as a vibration of the joint."""
    for effort in efforts(tmp_path, rate_hz, 492.0):
        assert effort == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("rate_hz", [500, 1000])
def test_a_line_within_the_band_of_the_work_grid_stays(tmp_path, rate_hz):
    for effort in efforts(tmp_path, rate_hz, 120.0):
        assert np.std(effort) * np.sqrt(2.0) == pytest.approx(0.5, rel=1e-3)
