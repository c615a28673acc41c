"""The only place that turns command messages into bytes and back.

Wire form: ``b"S2R1"`` + CRC-32 of the rest (little endian) + one serialised :class:`Envelope`.
The checksum comes first because protobuf alone accepts most single-bit errors without complaint.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import TypeVar

from google.protobuf.message import DecodeError, Message

from s2r_protocol.faults import Refusal
from s2r_protocol.proto import s2r_pb2 as pb

MAGIC = b"S2R1"
SCHEMA_VERSION = 1
MAX_MESSAGE_BYTES = 8 * 1024 * 1024
MAX_SENDER_CHARACTERS = 200  # it goes into log lines, states and recordings
_HEADER = struct.Struct("<4sI")

M = TypeVar("M", bound=Message)


class MessageRefusedError(ValueError):
    """A message was refused at the door; ``code`` says why in one word, the text in one sentence."""

    def __init__(self, code: Refusal, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class Address:
    """What the envelope says about sender and intended receiver.

    Attributes:
        boot_id: Of the executor process the message is meant for; 0 only in Hello.
        epoch: Of the lease the sender holds.
        seq: Strictly rising per sender; a repeat is answered as before and has no effect.
        model_hash: SHA-256 of the arm model, 32 bytes.
        limit_hash: SHA-256 of the limits, 32 bytes.
        sender: Shown to the operator; at most 200 printable characters.
    """

    sender: str
    boot_id: int = 0
    epoch: int = 0
    seq: int = 0
    model_hash: bytes = b""
    limit_hash: bytes = b""


def seal(body: Message, address: Address) -> bytes:
    """Wrap a body for the wire."""
    envelope = pb.Envelope(
        schema_version=SCHEMA_VERSION,
        boot_id=address.boot_id,
        epoch=address.epoch,
        seq=address.seq,
        model_hash=address.model_hash,
        limit_hash=address.limit_hash,
        sender=address.sender,
        kind=body.DESCRIPTOR.full_name,
        body=body.SerializeToString(),
    )
    rest = envelope.SerializeToString()
    return _HEADER.pack(MAGIC, zlib.crc32(rest)) + rest


def open_envelope(wire: bytes) -> pb.Envelope:
    """Check magic, size, checksum, schema version and the sender's name; the body stays unparsed.

    Raises:
        MessageRefusedError: With code MALFORMED.
    """
    if len(wire) < _HEADER.size:
        raise MessageRefusedError(
            Refusal.MALFORMED, f"message of {len(wire)} bytes is shorter than its {_HEADER.size}-byte header"
        )
    if len(wire) > MAX_MESSAGE_BYTES:
        raise MessageRefusedError(
            Refusal.MALFORMED, f"message of {len(wire)} bytes exceeds the limit of {MAX_MESSAGE_BYTES}"
        )
    magic, crc = _HEADER.unpack_from(wire)
    rest = wire[_HEADER.size :]
    if magic != MAGIC:
        raise MessageRefusedError(Refusal.MALFORMED, f"message starts with {magic!r}, expected {MAGIC!r}")
    if zlib.crc32(rest) != crc:
        raise MessageRefusedError(
            Refusal.MALFORMED, "message checksum (CRC-32) does not match: damaged in transit"
        )
    envelope = pb.Envelope()
    try:
        envelope.ParseFromString(rest)
    except DecodeError as error:
        raise MessageRefusedError(
            Refusal.MALFORMED, f"message envelope cannot be decoded: {error}"
        ) from error
    if envelope.schema_version != SCHEMA_VERSION:
        raise MessageRefusedError(
            Refusal.MALFORMED,
            f"message schema version {envelope.schema_version} is not {SCHEMA_VERSION}; "
            "run the same release on both sides",
        )
    if len(envelope.sender) > MAX_SENDER_CHARACTERS or not envelope.sender.isprintable():
        raise MessageRefusedError(
            Refusal.MALFORMED,
            f"the sender's name, {envelope.sender[:40]!r} of {len(envelope.sender)} characters, is not one of at most "
            f"{MAX_SENDER_CHARACTERS} printable ones",
        )
    return envelope


def open_body(envelope: pb.Envelope, expected: type[M]) -> M:
    """Parse the body as the expected message type.

    Raises:
        MessageRefusedError: With code MALFORMED when the kind differs or the bytes do not decode.
    """
    name = expected.DESCRIPTOR.full_name
    if envelope.kind != name:
        raise MessageRefusedError(
            Refusal.MALFORMED, f"expected a {name} here, got {envelope.kind or 'nothing'}"
        )
    body = expected()
    try:
        body.ParseFromString(envelope.body)
    except DecodeError as error:
        raise MessageRefusedError(Refusal.MALFORMED, f"{name} cannot be decoded: {error}") from error
    return body


def address_of(envelope: pb.Envelope) -> Address:
    """The envelope's address fields as a domain object."""
    return Address(
        sender=envelope.sender,
        boot_id=envelope.boot_id,
        epoch=envelope.epoch,
        seq=envelope.seq,
        model_hash=envelope.model_hash,
        limit_hash=envelope.limit_hash,
    )
