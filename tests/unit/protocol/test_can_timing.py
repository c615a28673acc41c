"""Wire time of frames, against bit counts from the standard done by hand."""

import pytest

from s2r_protocol.can.timing import (
    BitRate,
    BusOverloadError,
    check_load,
    classic_frame_ns,
    cycle_ns,
    cyclic_load,
    fd_frame_ns,
)


def test_classic_eight_byte_frame_is_111_to_135_bits():
    assert classic_frame_ns(8, stuffed=False) == 111_000
    assert classic_frame_ns(8) == 135_000
    assert classic_frame_ns(1) == 65_000


def test_fd_frames_take_the_computed_time():
    assert fd_frame_ns(64) == 169_600
    assert fd_frame_ns(16) == 72_600


def test_seven_drives_at_1_khz_fit_the_fd_bus():
    assert cycle_ns("fd", 7) == 677_800
    assert cycle_ns("fd", 7, stuffed=False) == 573_800
    assert cyclic_load("fd", 7, 1_000_000) == pytest.approx(0.678, abs=5e-4)
    assert cyclic_load("fd", 7, 1_000_000, BitRate(data=8_000_000)) == pytest.approx(0.526, abs=5e-4)


def test_seven_drives_at_250_hz_fill_half_the_classic_bus():
    assert cycle_ns("classic", 7) == 14 * 135_000 + 65_000
    assert cyclic_load("classic", 7, 4_000_000) == pytest.approx(0.489, abs=5e-4)


@pytest.mark.parametrize(
    ("packing", "tick_ns", "rate"),
    [
        ("classic", 2_000_000, BitRate()),
        ("classic", 1_000_000, BitRate()),
        ("fd", 1_000_000, BitRate(data=2_000_000)),
    ],
)
def test_impossible_configuration_is_refused(packing, tick_ns, rate):
    with pytest.raises(BusOverloadError, match="exceeds 70 %"):
        check_load(packing, 7, tick_ns, rate)


def test_recommended_configurations_pass():
    assert check_load("fd", 7, 1_000_000) == pytest.approx(0.678, abs=1e-3)
    assert 0.489 < check_load("classic", 7, 4_000_000) < 0.53


def test_unknown_packing_is_named():
    with pytest.raises(ValueError, match="'xl'"):
        cycle_ns("xl", 7)
