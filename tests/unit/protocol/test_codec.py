"""Sealed messages: what is damaged, foreign or of another version never reaches a parser."""

import struct
import zlib

import pytest

from s2r_protocol import codec
from s2r_protocol.faults import Refusal
from s2r_protocol.proto import s2r_pb2 as pb

ADDRESS = codec.Address("host:1", boot_id=7, epoch=3, seq=12, model_hash=b"m" * 32, limit_hash=b"l" * 32)


def _reseal(envelope):
    rest = envelope.SerializeToString()
    return struct.pack("<4sI", codec.MAGIC, zlib.crc32(rest)) + rest


def test_a_sealed_message_opens_to_the_same_body_and_address():
    plan = pb.Plan(joint_names=["a", "b"], t=[0.0, 1.0], q=[0.1, 0.2, 0.3, 0.4], label="push")
    envelope = codec.open_envelope(codec.seal(plan, ADDRESS))
    assert codec.open_body(envelope, pb.Plan) == plan
    assert codec.address_of(envelope) == ADDRESS


def test_every_single_bit_flip_is_refused():
    wire = codec.seal(pb.Plan(t=[0.0, 0.5], q=[1.0] * 14), ADDRESS)
    for i in range(8 * len(wire)):
        damaged = bytearray(wire)
        damaged[i // 8] ^= 1 << (i % 8)
        with pytest.raises(codec.MessageRefusedError) as refused:
            codec.open_envelope(bytes(damaged))
        assert refused.value.code is Refusal.MALFORMED


def test_every_truncation_is_refused():
    wire = codec.seal(pb.Heartbeat(count=5), ADDRESS)
    for n in range(len(wire)):
        with pytest.raises(codec.MessageRefusedError):
            codec.open_envelope(wire[:n])


def test_another_schema_version_is_refused_before_the_body_is_parsed():
    envelope = codec.open_envelope(codec.seal(pb.Heartbeat(), ADDRESS))
    envelope.schema_version = 99
    envelope.body = b"\xff\xff not a heartbeat"
    with pytest.raises(codec.MessageRefusedError, match="schema version 99 is not 1"):
        codec.open_envelope(_reseal(envelope))


@pytest.mark.parametrize("sender", ["x" * 201, "host:1\n12:00:00 INFO forged", "host:\x1b[2J", "\x00"])
def test_a_senders_name_that_is_no_short_printable_line_is_refused(sender):
    with pytest.raises(
        codec.MessageRefusedError, match=r"the sender's name.*at most 200 printable"
    ) as refused:
        codec.open_envelope(codec.seal(pb.Heartbeat(), codec.Address(sender)))
    assert refused.value.code is Refusal.MALFORMED
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize("sender", ["", "x" * 200, "Gerät 7: Meßplatz"])
def test_a_senders_name_may_be_any_short_printable_line(sender):
    wire = codec.seal(pb.Heartbeat(), codec.Address(sender))
    assert codec.address_of(codec.open_envelope(wire)).sender == sender


def test_a_body_of_another_kind_is_refused():
    envelope = codec.open_envelope(codec.seal(pb.Heartbeat(), ADDRESS))
    with pytest.raises(codec.MessageRefusedError, match=r"expected a s2r.Plan here, got s2r.Heartbeat"):
        codec.open_body(envelope, pb.Plan)


def test_a_body_that_does_not_decode_is_refused():
    envelope = codec.open_envelope(codec.seal(pb.Plan(), ADDRESS))
    envelope.body = b"\x0a\xff\xff\xff\xff\x7f"
    with pytest.raises(codec.MessageRefusedError, match=r"s2r.Plan cannot be decoded"):
        codec.open_body(envelope, pb.Plan)


def test_an_oversized_message_is_refused_before_its_checksum_is_computed():
    with pytest.raises(codec.MessageRefusedError, match="exceeds the limit"):
        codec.open_envelope(bytes(codec.MAX_MESSAGE_BYTES + 1))
