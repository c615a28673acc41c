"""The classical packing and the words of CiA 402."""

import struct

import pytest

from s2r_protocol.can import classic
from s2r_protocol.can.drive import (
    STATUSWORD,
    DriveCommand,
    DriveError,
    DriveState,
    command_of,
    emergency_code,
    state_of,
)
from s2r_protocol.can.frames import FrameRefusedError


def test_rpdo1_layout_is_the_documented_one():
    payload = classic.pack_rpdo1(classic.Command(0x000F, 0.5, -0.1))
    assert payload == struct.pack("<Hih", 0x000F, 125_000_000, -500)
    assert classic.unpack_rpdo1(payload) == classic.Command(0x000F, 0.5, pytest.approx(-0.1))


def test_tpdo1_layout_is_the_documented_one():
    payload = classic.pack_tpdo1(classic.Position(0x1237, -0.5, 0.00123))
    assert payload == struct.pack("<Hih", 0x1237, -125_000_000, 123)
    assert classic.unpack_tpdo1(payload).state == DriveState.OPERATION_ENABLED


def test_following_error_saturates_instead_of_wrapping():
    assert classic.unpack_tpdo1(classic.pack_tpdo1(classic.Position(0, 0.0, 1.0))).following_error == 0.32767


def test_tpdo2_survives_the_wire():
    health = classic.Health(-28.5, 0x8611, 44)
    assert classic.unpack_tpdo2(classic.pack_tpdo2(health)) == health
    assert len(classic.pack_tpdo2(health)) == 5


def test_wrong_length_is_refused():
    with pytest.raises(FrameRefusedError, match="RPDO1 payload of 7 bytes, expected 8"):
        classic.unpack_rpdo1(bytes(7))


@pytest.mark.parametrize("state", list(DriveState))
def test_statusword_tells_every_state(state):
    assert state_of(STATUSWORD[state] | 0x1200) == state  # remote and "follows" bits do not matter


def test_impossible_statusword_is_named():
    with pytest.raises(ValueError, match="0x0001"):
        state_of(0x0001)


@pytest.mark.parametrize("command", list(DriveCommand))
def test_usual_controlwords_mean_their_command(command):
    assert command_of(command) == command


def test_bits_that_do_not_matter_do_not_matter():
    assert command_of(0x0E) == DriveCommand.SHUTDOWN
    assert command_of(0x0D) == DriveCommand.DISABLE_VOLTAGE
    assert command_of(0x0B) == DriveCommand.QUICK_STOP
    assert command_of(0x1F) == DriveCommand.ENABLE_OPERATION


def test_emergency_codes_belong_to_their_class():
    assert emergency_code(DriveError.NONE) == 0
    assert all(emergency_code(error) >> 8 == error for error in DriveError)
