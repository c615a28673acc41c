"""The CAN FD packing, checked against bytes laid out by hand."""

import struct
import zlib

import numpy as np
import pytest

from s2r_protocol.can import fd
from s2r_protocol.can.drive import DriveState
from s2r_protocol.can.frames import FrameRefusedError

Q = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]
DQ = [0.01, -0.02, 0.03, -0.04, 0.05, -0.06, 0.07]
TAU = [1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0]


def status(**changes):
    base = {
        "node": 3,
        "seq": 200,
        "tick": 65_535,
        "state": DriveState.OPERATION_ENABLED,
        "brake_released": True,
        "following_warning": False,
        "q_meas": -1.5,
        "dq_meas": 0.25,
        "tau_meas": -12.34,
        "error": 0x86,
        "temp_C": 41,
    }
    return fd.Status(**{**base, **changes})


def crc16_ccitt_false(data):
    """Bit by bit, from the definition: polynomial 0x1021, start 0xFFFF, no reflection."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021) & 0xFFFF if crc & 0x8000 else crc << 1 & 0xFFFF
    return crc


def test_set_layout_is_the_documented_one():
    payload = fd.pack_set(5, 2, 0x1234, Q, DQ, TAU)
    assert len(payload) == 64
    assert payload[:4] == bytes([5, 2, 0x34, 0x12])
    assert struct.unpack_from("<I", payload, 4)[0] == zlib.crc32(payload[:4] + payload[8:])
    for i in range(7):
        position, velocity, torque = struct.unpack_from("<ihh", payload, 8 + 8 * i)
        assert (position, velocity, torque) == (
            round(Q[i] * 2.5e8),
            round(DQ[i] / 2e-4),
            round(TAU[i] / 0.01),
        )


def test_set_survives_the_wire():
    point = fd.unpack_set(fd.pack_set(300, 2, 70_000, Q, DQ, TAU))
    assert (point.seq, point.control, point.tick) == (300 & 0xFF, 2, 70_000 & 0xFFFF)
    np.testing.assert_allclose(point.q, Q, atol=2e-9)
    np.testing.assert_allclose(point.dq, DQ, atol=1e-4)
    np.testing.assert_allclose(point.tau_ff, TAU, atol=5e-3)


def test_slots_beyond_the_arm_are_zero():
    assert fd.pack_set(1, 0, 1, Q[:6])[8 + 48 :] == bytes(8)


def test_eighth_joint_is_refused():
    with pytest.raises(FrameRefusedError, match="8 joints do not fit"):
        fd.pack_set(1, 0, 1, [0.0] * 8)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 8.6, -8.6])
def test_position_that_does_not_fit_is_refused(bad):
    with pytest.raises(FrameRefusedError, match="position"):
        fd.pack_set(1, 2, 1, [bad, *Q[1:]])


def test_every_flipped_bit_of_set_is_noticed():
    payload = fd.pack_set(5, 2, 0x1234, Q, DQ, TAU)
    for bit in range(8 * len(payload)):
        damaged = bytearray(payload)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(FrameRefusedError, match="CRC-32"):
            fd.unpack_set(bytes(damaged))


def test_stat_layout_is_the_documented_one():
    payload = fd.pack_stat(status())
    fields = struct.unpack("<BBihhHBBH", payload)
    assert fields[:-1] == (200, 4 | 0x10, round(-1.5 * 2.5e8), 1250, -1234, 65_535, 0x86, 41)
    assert fields[-1] == crc16_ccitt_false(payload[:14] + bytes([3]))


def test_crc16_has_the_published_check_value():
    assert crc16_ccitt_false(b"123456789") == 0x29B1


@pytest.mark.parametrize("state", list(DriveState))
def test_stat_survives_the_wire(state):
    sent = status(state=state, brake_released=False, following_warning=True)
    got = fd.unpack_stat(fd.pack_stat(sent), 3)
    assert got.q_meas == pytest.approx(sent.q_meas, abs=2e-9)
    assert (got.state, got.brake_released, got.following_warning) == (state, False, True)
    assert (got.seq, got.tick, got.error, got.temp_C) == (200, 65_535, 0x86, 41)


def test_every_flipped_bit_of_stat_is_noticed():
    payload = fd.pack_stat(status())
    for bit in range(8 * len(payload)):
        damaged = bytearray(payload)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(FrameRefusedError, match="CRC-16"):
            fd.unpack_stat(bytes(damaged), 3)


def test_stat_under_another_nodes_identifier_is_noticed():
    with pytest.raises(FrameRefusedError, match="node 4: CRC-16"):
        fd.unpack_stat(fd.pack_stat(status()), 4)


@pytest.mark.parametrize(("unpack", "size"), [(fd.unpack_set, 63), (lambda p: fd.unpack_stat(p, 1), 8)])
def test_wrong_length_is_refused(unpack, size):
    with pytest.raises(FrameRefusedError, match=f"{size} bytes"):
        unpack(bytes(size))
