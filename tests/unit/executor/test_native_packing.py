"""Both packings against the byte layouts written down as struct formats."""

from __future__ import annotations

import struct
import zlib
from binascii import crc_hqx

import numpy as np
import pytest

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")

SET = struct.Struct("<BBHI" + 7 * "ihh")
STAT = struct.Struct("<BBihhHBB")
ANSWER, IGNORED, CORRUPT, FOREIGN_MASTER, EMERGENCY, BUS_ERROR, BUS_OFF = range(7)


def stat(node: int, seq: int, state: int, position: int, velocity: int, torque: int, tick: int) -> bytes:
    body = STAT.pack(seq, state, position, velocity, torque, tick, 0x86, 41)
    return body + struct.pack("<H", crc_hqx(body + bytes([node]), 0xFFFF))


@pytest.fixture
def fd():
    packing = _native.Packing("fd", 7)
    packing.encode(1000, 9, 2, np.zeros(7), np.zeros(7))
    return packing


@pytest.fixture
def classic():
    return _native.Packing("classic", 7, 0.004)


def test_crc16_of_the_check_string():
    assert _native.crc16(b"12345678", ord("9")) == 0x29B1


def test_set_frame_has_the_layout_of_the_wire():
    rng = np.random.default_rng(1)
    q, dq = rng.uniform(-6, 6, 7), rng.uniform(-4, 4, 7)
    ((can_id, data, is_fd),) = _native.Packing("fd", 7).encode(0x1_2345, 0xAB, 3, q, dq)
    assert (can_id, is_fd, len(data)) == (0x080, True, 64)
    seq, ctrl, tick, crc, *slots = SET.unpack(data)
    assert (seq, ctrl, tick) == (0xAB, 3, 0x2345)
    assert crc == zlib.crc32(data[:4] + data[8:])
    assert slots[0::3] == [round(x / 4e-9) for x in q]
    assert slots[1::3] == [round(x / 2e-4) for x in dq]
    assert slots[2::3] == [0] * 7


def test_arm_with_fewer_joints_leaves_slots_zero():
    ((_, data, _),) = _native.Packing("fd", 4).encode(1, 1, 2, np.full(4, 0.5), np.full(4, 0.5))
    assert data[8 + 4 * 8 :] == bytes(24)
    assert 0 not in SET.unpack(data)[4::3][:4]


def test_stat_frame_is_read_field_by_field(fd):
    assert fd.decode(0x183, stat(3, 9, 0x34, -250_000_000, -5000, 1234, 1000), True) == (ANSWER, 2)
    drive = fd.drive(2)
    assert drive["q"] == pytest.approx(-1.0, abs=1e-12)
    assert drive["dq"] == pytest.approx(-1.0)
    assert drive["tau"] == pytest.approx(12.34)
    assert (drive["state"], drive["brake_released"], drive["following_warning"]) == (4, True, True)
    assert (drive["error"], drive["temperature_C"], drive["answered_tick"]) == (0x86, 41, 1000)
    assert not fd.drive(1)["seen"]


@pytest.mark.parametrize("counts", [-(2**31) + 1, -1, 0, 1, 2**31 - 1])
def test_positions_survive_the_wire_both_ways(fd, counts):
    fd.decode(0x181, stat(1, 9, 4, counts, 0, 0, 1000), True)
    ((_, data, _),) = fd.encode(1001, 10, 2, np.r_[fd.drive(0)["q"], np.zeros(6)], np.zeros(7))
    assert SET.unpack(data)[4] == counts


@pytest.mark.parametrize(
    ("tick", "kind"),
    [(1000, ANSWER), (999, ANSWER), (1, ANSWER), (1001, CORRUPT), (65535, CORRUPT)],
)
def test_answer_is_dated_by_the_tick_it_echoes(fd, tick, kind):
    assert fd.decode(0x181, stat(1, 9, 4, 0, 0, 0, tick), True)[0] == kind
    if kind == ANSWER:
        assert fd.drive(0)["answered_tick"] == tick


def test_answer_overtaken_by_a_newer_one_is_ignored(fd):
    fd.decode(0x181, stat(1, 9, 4, 100, 0, 0, 1000), True)
    assert fd.decode(0x181, stat(1, 8, 4, 50, 0, 0, 999), True)[0] == IGNORED
    assert fd.drive(0)["q"] == pytest.approx(100 * 4e-9)


def test_fresh_tick_with_a_wrong_counter_is_corrupt(fd):
    assert fd.decode(0x181, stat(1, 8, 4, 0, 0, 0, 1000), True)[0] == CORRUPT


def test_answer_under_another_node_number_is_corrupt(fd):
    assert fd.decode(0x182, stat(1, 9, 4, 0, 0, 0, 1000), True) == (CORRUPT, 1)


def test_classical_frame_of_the_same_length_is_corrupt(fd):
    assert fd.decode(0x181, bytes(8), False)[0] == CORRUPT


@pytest.mark.parametrize("can_id", [0x000, 0x07F, 0x081, 0x180, 0x188, 0x701, 0x7FF])
def test_other_identifiers_are_ignored(fd, can_id):
    assert fd.decode(can_id, bytes(8), True) == (IGNORED, -1)


@pytest.mark.parametrize("packing", ["fd", "classic"])
def test_setpoint_of_somebody_else_is_a_foreign_master(packing):
    assert _native.Packing(packing, 7).decode(0x080, bytes(1), packing == "fd") == (FOREIGN_MASTER, -1)


@pytest.mark.parametrize("packing", ["fd", "classic"])
def test_error_frames_tell_bus_off_from_the_rest(packing):
    link = _native.Packing(packing, 7)
    assert link.decode(0x2000_0040, bytes(8), False)[0] == BUS_OFF
    assert link.decode(0x2000_0004, bytes(8), False)[0] == BUS_ERROR


def test_classical_setpoints_come_before_their_sync(classic):
    q, dq = np.linspace(-3, 3, 7), np.linspace(2, -2, 7)
    frames = classic.encode(5, 0, 2, q, dq)
    assert [f[0] for f in frames] == [0x201, 0x202, 0x203, 0x204, 0x205, 0x206, 0x207, 0x000, 0x080]
    assert not any(is_fd for _, _, is_fd in frames)
    for joint in range(7):
        _, target, velocity = struct.unpack("<Hih", frames[joint][1])
        assert target == round(q[joint] / 4e-9)
        assert velocity == round(dq[joint] / 2e-4)
    assert frames[7][1] == b"\x01\x00"  # start all nodes, once
    assert frames[8][1] == bytes([1 + 5])
    assert [f[0] for f in classic.encode(6, 1, 2, q, dq)][-2:] == [0x207, 0x080]


def test_sync_counter_stays_in_its_range(classic):
    counters = {classic.encode(tick, 0, 0, np.zeros(7), np.zeros(7))[-1][1][0] for tick in range(1000)}
    assert counters == set(range(1, 241))


def test_node_that_boots_late_is_started_again(classic):
    zeros = np.zeros(7)
    classic.encode(0, 0, 0, zeros, zeros)
    classic.decode(0x703, b"\x7f", False)
    assert 0x000 in [f[0] for f in classic.encode(1, 1, 0, zeros, zeros)]
    classic.decode(0x703, b"\x05", False)
    assert 0x000 not in [f[0] for f in classic.encode(2, 2, 0, zeros, zeros)]


def test_classical_answer_is_read_and_gives_the_velocity_by_difference(classic):
    zeros = np.zeros(7)
    classic.encode(10, 0, 2, zeros, zeros)
    assert classic.decode(0x184, struct.pack("<Hih", 0x7237, 1_000_000, -3), False) == (ANSWER, 3)
    classic.encode(12, 1, 2, zeros, zeros)
    classic.decode(0x184, struct.pack("<Hih", 0x1237, 1_400_000, 0), False)
    drive = classic.drive(3)
    assert drive["q"] == pytest.approx(1_400_000 * 4e-9)
    assert drive["dq"] == pytest.approx(400_000 * 4e-9 / (2 * 0.004))
    assert (drive["state"], drive["answered_tick"]) == (4, 12)
    classic.decode(0x284, struct.pack("<hHB", -250, 0x8611, 55), False)
    assert classic.drive(3)["tau"] == pytest.approx(-2.5)
    assert (classic.drive(3)["error"], classic.drive(3)["temperature_C"]) == (0x8611, 55)
    assert classic.decode(0x084, struct.pack("<HB5x", 0x8130, 0), False) == (EMERGENCY, 3)


@pytest.mark.parametrize("length", [0, 2, 7])
def test_an_emergency_of_another_length_changes_no_error(classic, length):
    classic.encode(10, 0, 2, np.zeros(7), np.zeros(7))
    assert classic.decode(0x081, struct.pack("<HB5x", 0x4210, 1), False) == (EMERGENCY, 0)
    assert classic.decode(0x081, bytes(length), False) == (CORRUPT, 0)
    assert classic.drive(0)["error"] == 0x4210


@pytest.mark.parametrize(
    ("statusword", "state"),
    [(0x00, 0), (0x40, 1), (0x31, 2), (0x33, 3), (0x37, 4), (0x17, 5), (0x1F, 6), (0x18, 7)],
)
@pytest.mark.parametrize("others", [0x0000, 0x0080, 0x1200, 0x6000])
def test_statusword_bits_tell_the_state(statusword, state, others):
    assert _native.drive_state(statusword | others) == state


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (0, [0x00] * 8),
        (1, [0x06, 0x06, 0x07, 0x07, 0x07, 0x07, 0x07, 0x07]),
        (2, [0x06, 0x00, 0x06, 0x0F, 0x0F, 0x02, 0x06, 0x06]),  # one that has dropped out stays where it is
        (3, [0x02] * 8),
        (4, [0x80] * 8),
        (5, [0x06, 0x00, 0x06, 0x07, 0x07, 0x02, 0x06, 0x06]),
    ],
)
def test_controlword_walks_the_402_states(request_, words):
    assert [_native.controlword(request_, state) for state in range(8)] == words


@pytest.mark.parametrize(
    ("packing", "allowed"),
    [
        ("fd", {(0x080, 64, True)}),
        ("classic", {(0x000, 2, False), (0x080, 1, False)} | {(0x200 + n, 8, False) for n in range(1, 8)}),
    ],
)
def test_only_the_listed_frames_may_leave(packing, allowed):
    link = _native.Packing(packing, 7)
    found = {
        (can_id, length, is_fd)
        for can_id in range(2048)
        for length in (0, 1, 2, 3, 7, 8, 16, 63, 64)
        for is_fd in (False, True)
        if link.tx_allowed(can_id, length, is_fd)
    }
    assert found == allowed


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 8.7, -8.7])
def test_position_that_does_not_fit_is_never_encoded(bad):
    with pytest.raises(ValueError, match="joint 2"):
        _native.Packing("fd", 7).encode(0, 0, 2, np.array([0, 0, bad, 0, 0, 0, 0.0]), np.zeros(7))


@pytest.mark.parametrize(
    ("packing", "dof", "tick_ns", "load"),
    [
        ("fd", 7, 1_000_000, 0.678),
        ("fd", 4, 1_000_000, 0.460),
        # 14 x 135 + 65 bits every 4 ms, 7 x 105 bits of TPDO2 every 32 ms, 7 heartbeats of 65 bits every 100 ms
        ("classic", 7, 4_000_000, 0.48875 + 0.02297 + 0.00455),
    ],
)
def test_bus_load_is_the_sum_of_the_frames(packing, dof, tick_ns, load):
    assert _native.bus_load(packing, dof, tick_ns) == pytest.approx(load, abs=6e-4)
