"""python-can on a local bus: a plain socket plays the stand-in."""

import importlib
import socket
import tomllib
from pathlib import Path

import can
import pytest

from s2r_protocol.can.frames import CanFrame
from s2r_protocol.can.python_can import StandInBus


@pytest.fixture
def joined(tmp_path):
    address = f"unix:{tmp_path}/bus.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(address.removeprefix("unix:"))
        listener.listen()
        with StandInBus(address) as bus:
            peer, _ = listener.accept()
            with peer:
                yield bus, peer


def test_message_arrives_as_a_kernel_frame(joined):
    bus, peer = joined
    bus.send(can.Message(arbitration_id=0x201, data=[1, 2, 3], is_extended_id=False))
    assert CanFrame.unpack(peer.recv(128)) == CanFrame(0x201, bytes([1, 2, 3]))


def test_fd_frame_arrives_as_a_message(joined):
    bus, peer = joined
    peer.send(CanFrame(0x181, bytes(range(16)), is_fd=True, brs=True).pack())
    message = bus.recv(1.0)
    assert (message.arbitration_id, message.is_fd, message.bitrate_switch) == (0x181, True, True)
    assert bytes(message.data) == bytes(range(16))


def test_silence_is_none(joined):
    bus, _ = joined
    assert bus.recv(0.0) is None


def test_filters_apply(joined):
    bus, peer = joined
    bus.set_filters([{"can_id": 0x180, "can_mask": 0x7F8, "extended": False}])
    peer.send(CanFrame(0x080, b"").pack())
    peer.send(CanFrame(0x187, b"\x01").pack())
    assert bus.recv(1.0).arbitration_id == 0x187


def test_closed_bus_is_reported(joined):
    bus, peer = joined
    peer.close()
    with pytest.raises(can.CanOperationError, match="closed by the stand-in"):
        bus.recv(1.0)


def test_missing_bus_is_reported(tmp_path):
    with pytest.raises(can.CanInitializationError, match="no stand-in bus"):
        StandInBus(f"unix:{tmp_path}/none.sock")


def test_entry_point_names_the_plug_in():
    pyproject = Path(__file__).parents[3] / "pyproject.toml"
    entry = tomllib.loads(pyproject.read_text())["project"]["entry-points"]["can.interface"]["s2r"]
    module, name = entry.split(":")
    assert getattr(importlib.import_module(module), name) is StandInBus
