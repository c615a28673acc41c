"""Kernel frame structs as bytes and back."""

import struct

import pytest

from s2r_protocol.can.frames import CanFrame, FrameRefusedError, connect_unix, unix_path
from s2r_protocol.exits import UnreachableError, UsageError


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x080, b""),
        CanFrame(0x181, bytes(range(8))),
        CanFrame(0x7FF, bytes(64), is_fd=True, brs=True),
        CanFrame(0x183, bytes(16), is_fd=True),
        CanFrame(0x1ABCDEF, b"\x01", extended=True),
        CanFrame(0x040, bytes(8), is_error=True),
    ],
)
def test_frame_survives_the_wire(frame):
    assert CanFrame.unpack(frame.pack()) == frame


def test_packed_frames_are_the_kernels_structs():
    classic = CanFrame(0x201, b"\x11\x22").pack()
    assert classic == struct.pack("=IB3x8s", 0x201, 2, b"\x11\x22")
    assert len(classic) == 16
    fd = CanFrame(0x080, bytes([7]) * 64, is_fd=True, brs=True).pack()
    assert fd == struct.pack("=IBB2x64s", 0x080, 64, 0x04 | 0x01, bytes([7]) * 64)
    assert len(fd) == 72


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (CanFrame(0x800, b""), "0x800 exceeds 0x7ff"),
        (CanFrame(0x1, bytes(9)), "9 bytes exceeds 8"),
        (CanFrame(0x1, bytes(9), is_fd=True), "none of the lengths CAN FD knows"),
    ],
)
def test_impossible_frame_is_refused(frame, text):
    with pytest.raises(FrameRefusedError, match=text):
        frame.pack()


def test_packet_of_another_size_is_refused():
    with pytest.raises(FrameRefusedError, match="17 bytes is neither"):
        CanFrame.unpack(bytes(17))


def test_packet_with_a_lying_length_is_refused():
    packet = bytearray(CanFrame(0x123, b"\x01").pack())
    packet[4] = 9
    with pytest.raises(FrameRefusedError, match="0x123 says 9 bytes, at most 8"):
        CanFrame.unpack(bytes(packet))


def test_only_unix_addresses_are_taken():
    assert unix_path("unix:/run/x.sock") == "/run/x.sock"
    with pytest.raises(UsageError, match="can0"):
        unix_path("can:can0")


def test_missing_bus_is_unreachable(tmp_path):
    with pytest.raises(UnreachableError, match="is 's2r sim-arm' running"):
        connect_unix(f"unix:{tmp_path}/none.sock")
