"""Asking drives one after the other: an answer counts only for the entry that was asked for."""

from __future__ import annotations

import struct

import pytest

from s2r_executor.sdo_client import SdoAbortError, SdoClient, SdoTimeoutError
from s2r_protocol.can import sdo
from s2r_protocol.can.frames import CanFrame

NODE = 3
VENDOR, PRODUCT = b"\x01\0\0\0", b"\x02\0\0\0"


class Line:
    """Answers every request with the next of these lists of payloads."""

    def __init__(self, *answers: list[bytes]) -> None:
        self._answers = list(answers)
        self._heard: list[CanFrame] = []

    def send(self, frame: CanFrame) -> None:
        assert frame.can_id == sdo.REQUEST_ID + NODE
        self._heard += [CanFrame(sdo.RESPONSE_ID + NODE, payload) for payload in self._answers.pop(0)]

    def receive(self, until_s: float) -> CanFrame | None:
        return self._heard.pop(0) if self._heard else None


def abort(index, subindex, code=sdo.NO_OBJECT):
    return sdo.pack_head(sdo.ABORT, index, subindex, struct.pack("<I", code))


def test_an_answer_that_comes_late_is_not_the_next_entrys_value():
    late = sdo.upload_response(0x1018, 1, VENDOR)
    client = SdoClient(Line([], [late, sdo.upload_response(0x1018, 2, PRODUCT)]))
    with pytest.raises(SdoTimeoutError):
        client.number(NODE, 0x1018, 1)
    assert client.number(NODE, 0x1018, 2) == 2


def test_an_abort_that_comes_late_is_not_the_next_entrys():
    client = SdoClient(Line([abort(0x5FFF, 0), sdo.upload_response(0x1018, 2, PRODUCT)]))
    assert client.number(NODE, 0x1018, 2) == 2


def test_only_a_late_answer_is_no_answer():
    client = SdoClient(Line([sdo.upload_response(0x1018, 1, VENDOR)]))
    with pytest.raises(SdoTimeoutError):
        client.number(NODE, 0x1018, 2)


def test_an_abort_of_the_entry_is_told_with_its_code():
    with pytest.raises(SdoAbortError, match="there is no such object"):
        SdoClient(Line([abort(0x1018, 9)])).number(NODE, 0x1018, 9)


def test_segments_are_put_together_and_late_ones_skipped():
    text = b"s2r stand-in"
    first, last = sdo.segment(0, text[:7], False), sdo.segment(sdo.TOGGLE, text[7:], True)
    late = sdo.upload_response(0x1018, 1, VENDOR)
    line = Line([late, sdo.upload_response(0x1008, 0, text)], [late, first], [first, last])
    assert SdoClient(line).upload(NODE, 0x1008) == text


def segments(text):
    """One list per request: the segments of a text, toggling."""
    parts = [text[i : i + 7] for i in range(0, len(text), 7)]
    return [[sdo.segment(sdo.TOGGLE * (i % 2), part, i == len(parts) - 1)] for i, part in enumerate(parts)]


def test_a_drive_that_does_not_tell_the_size_of_its_answer_is_read_to_the_end():
    """CiA 301 leaves the size out at will; the four bytes mean nothing then."""
    text = b"s2r stand-in"
    unsized = sdo.pack_head(sdo.UPLOAD, 0x1008, 0)
    assert SdoClient(Line([unsized], *segments(text))).upload(NODE, 0x1008) == text


def test_an_answer_that_ends_before_its_size_is_none():
    text = b"s2r stand-in"
    line = Line([sdo.upload_response(0x1008, 0, text)], *segments(text[:9]))
    with pytest.raises(SdoTimeoutError, match=r"object 0x1008:0 ended after 9 of 12 bytes"):
        SdoClient(line).upload(NODE, 0x1008)


def test_an_answer_that_never_ends_is_given_up():
    endless = [[sdo.segment(sdo.TOGGLE * (i % 2), b"1234567", False)] for i in range(20_000)]
    line = Line([sdo.pack_head(sdo.UPLOAD, 0x1008, 0)], *endless)
    with pytest.raises(SdoTimeoutError, match=r"object 0x1008:0 does not end"):
        SdoClient(line).upload(NODE, 0x1008)
    sized = Line([sdo.upload_response(0x1008, 0, b"s2r stand-in")], *endless)
    with pytest.raises(SdoTimeoutError, match=r"object 0x1008:0 does not end after its 12 bytes"):
        SdoClient(sized).upload(NODE, 0x1008)
