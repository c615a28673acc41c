"""CANopen SDO uploads (CiA 301, 7.2.4): asking a drive for an entry of its object dictionary, on the bytes.

Expedited and segmented uploads, and the abort: what commissioning needs. Nothing is ever written to a drive.
"""

from __future__ import annotations

import struct

REQUEST_ID = 0x600  # + node
RESPONSE_ID = 0x580  # + node
MAX_NODE = 127

UPLOAD, UPLOAD_SEGMENT, DOWNLOAD, ABORT = 0x40, 0x60, 0x20, 0x80
TOGGLE = 0x10
SIZE_TOLD = 0x01  # in a first answer
NO_OBJECT, NO_SUBINDEX, READ_ONLY = 0x0602_0000, 0x0609_0011, 0x0601_0002
BAD_COMMAND, BAD_TOGGLE = 0x0504_0001, 0x0503_0000

_HEAD = struct.Struct("<BHB4s")


def pack_head(command: int, index: int, subindex: int, data: bytes = b"") -> bytes:
    """An initiating frame: command, entry, four bytes."""
    return _HEAD.pack(command, index, subindex, data)


def unpack_head(payload: bytes) -> tuple[int, int, int, bytes]:
    """Command, index, subindex and the last four bytes; the payload must have eight."""
    return _HEAD.unpack(payload)


def upload_response(index: int, subindex: int, value: bytes) -> bytes:
    """First answer to an upload: the value itself up to four bytes, else its size."""
    if len(value) <= 4:
        return pack_head(UPLOAD | (4 - len(value)) << 2 | 0x03, index, subindex, value)
    return pack_head(UPLOAD | SIZE_TOLD, index, subindex, struct.pack("<I", len(value)))


def answers(payload: bytes, command: int, index: int, subindex: int) -> bool:
    """Whether this answers that entry's request: UPLOAD (its first answer), ABORT, or a segment of this toggle.

    A segment carries no entry; its toggle alone tells it from the one before.
    """
    if command in (UPLOAD, ABORT):
        return payload[0] & 0xE0 == command and unpack_head(payload)[1:3] == (index, subindex)
    return payload[0] & (0xE0 | TOGGLE) == command


def expedited(command: int, data: bytes) -> bytes | None:
    """The value in a first answer, or None if it comes in segments."""
    if not command & 0x02:
        return None
    return data[: 4 - (command >> 2 & 0x03)] if command & SIZE_TOLD else data


def segment(toggle: int, part: bytes, last: bool) -> bytes:
    """One segment of up to seven bytes."""
    return bytes([toggle | (7 - len(part)) << 1 | last]) + part.ljust(7, b"\0")


def segment_part(payload: bytes) -> tuple[bytes, bool]:
    """The bytes of a segment, and whether it is the last."""
    return payload[1 : 8 - (payload[0] >> 1 & 0x07)], bool(payload[0] & 0x01)
