"""The emulated drives' SDO servers, frame by frame."""

import struct

import pytest

from s2r_protocol.can import sdo
from s2r_protocol.can.frames import CanFrame
from s2r_sim.bus.object_dictionary import SdoServers
from s2r_sim.drives_alone import DrivesAlone

NAME = (0x1008, 0)  # longer than four bytes: comes in segments


@pytest.fixture
def ask(arm):
    """What drive 3 answers to a request."""
    servers = SdoServers(DrivesAlone(arm).drives, arm, 1_000_000)

    def ask(command, index=0, subindex=0, data=b""):
        request = CanFrame(sdo.REQUEST_ID + 3, sdo.pack_head(command, index, subindex, data))
        return [CanFrame.unpack(packet).data for packet in servers.answer(request.can_id, request.pack())]

    return ask


def abort(entry, code):
    index, subindex = entry
    return sdo.pack_head(sdo.ABORT, index, subindex, struct.pack("<I", code))


def test_a_name_is_read_in_segments(ask):
    (first,) = ask(sdo.UPLOAD, *NAME)
    assert sdo.answers(first, sdo.UPLOAD, *NAME)
    told, toggle, last = b"", 0, False
    while not last:
        part, last = sdo.segment_part(ask(sdo.UPLOAD_SEGMENT | toggle)[0])
        told, toggle = told + part, toggle ^ sdo.TOGGLE
    assert told == b"s2r stand-in drive, joint 3"
    assert ask(sdo.UPLOAD_SEGMENT | toggle) == [abort((0, 0), sdo.BAD_COMMAND)]


def test_an_abort_of_the_client_ends_the_transfer_and_is_not_answered(ask):
    ask(sdo.UPLOAD, *NAME)
    assert ask(sdo.ABORT, *NAME, struct.pack("<I", 0x0800_0000)) == []
    assert ask(sdo.UPLOAD_SEGMENT) == [abort((0, 0), sdo.BAD_COMMAND)]


def test_an_abort_between_segments_names_its_entry(ask):
    ask(sdo.UPLOAD, *NAME)
    assert ask(sdo.UPLOAD_SEGMENT | sdo.TOGGLE) == [abort(NAME, sdo.BAD_TOGGLE)]


def test_what_is_not_there_and_what_cannot_be_written_is_told_by_its_code(ask):
    assert ask(sdo.UPLOAD, 0x5000, 0) == [abort((0x5000, 0), sdo.NO_OBJECT)]
    assert ask(sdo.UPLOAD, 0x1018, 9) == [abort((0x1018, 9), sdo.NO_SUBINDEX)]
    assert ask(sdo.DOWNLOAD, 0x6060, 0) == [abort((0x6060, 0), sdo.READ_ONLY)]
