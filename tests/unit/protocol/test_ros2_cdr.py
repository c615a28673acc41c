"""CDR packing, judged by two independent decoders: rosbags and mcap_ros2."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from s2r_protocol.ros2 import CdrError, JointStateEncoder, pack, unpack
from s2r_protocol.ros2.definitions import PRIMITIVES, Field, all_names, message_type, schema_text

_RANGES = {
    "bool": (0, 1),
    "byte": (0, 255),
    "int8": (-128, 127),
    "uint8": (0, 255),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**62), 2**62),
    "uint64": (0, 2**63 - 1),
}


@pytest.fixture(scope="module")
def store():
    types = get_typestore(Stores.ROS2_JAZZY)
    for name in ("s2r_msgs/msg/ExecutorState", "s2r_msgs/msg/TickTiming"):
        types.register(get_types_from_msg(message_type(name).text, name))
    return types


def random_element(base, rng):
    if base == "string":
        return "".join(rng.choice(list("abcäöü €xyz"), size=rng.integers(0, 9)))
    if base == "bool":
        return bool(rng.integers(0, 2))
    if base.startswith("float"):
        return float(np.dtype(base).type(rng.normal()))
    if base in PRIMITIVES:
        low, high = _RANGES[base]
        return int(rng.integers(low, high, endpoint=True))
    return random_values(base, rng)


def random_value(field: Field, rng):
    if not field.is_array:
        return random_element(field.base, rng)
    count = field.count if field.is_fixed else int(rng.integers(0, 5))
    return [random_element(field.base, rng) for _ in range(count)]


def random_values(name, rng):
    return {field.name: random_value(field, rng) for field in message_type(name).fields}


def assert_same(ours, theirs, where):
    """Compare our plain values with a decoder's message object, field by field."""
    for key, value in ours.items():
        other = getattr(theirs, key)
        if isinstance(value, dict):
            assert_same(value, other, f"{where}.{key}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            assert len(value) == len(other), f"{where}.{key}"
            for i, (a, b) in enumerate(zip(value, other, strict=True)):
                assert_same(a, b, f"{where}.{key}[{i}]")
        elif isinstance(value, list):
            assert list(value) == list(other), f"{where}.{key}"
        else:
            assert value == other, f"{where}.{key}"


@pytest.mark.parametrize("name", all_names())
def test_rosbags_reads_every_message_type_as_packed(name, store):
    rng = np.random.default_rng(7)
    for _ in range(20):
        values = random_values(name, rng)
        assert_same(values, store.deserialize_cdr(pack(name, values), name), name)


@pytest.mark.parametrize("name", all_names())
def test_mcap_ros2_reads_every_message_type_with_our_schema_text(name):
    rng = np.random.default_rng(8)
    schema = Schema(id=1, name=name, encoding="ros2msg", data=schema_text(name).encode())
    decode = DecoderFactory().decoder_for("cdr", schema)
    assert decode is not None
    for _ in range(10):
        values = random_values(name, rng)
        assert_same(values, decode(pack(name, values)), name)


@pytest.mark.parametrize("name", all_names())
def test_unpacking_what_rosbags_packed_gives_the_same_values(name, store):
    rng = np.random.default_rng(9)
    values = random_values(name, rng)
    wire = pack(name, values)
    again = bytes(store.serialize_cdr(store.deserialize_cdr(wire, name), name))
    assert again[: len(wire)] == wire  # rosbags may pad the end
    assert not any(again[len(wire) :])
    assert pack(name, unpack(name, again)) == wire


def test_missing_fields_become_zero_or_empty():
    values = unpack("s2r_msgs/msg/ExecutorState", pack("s2r_msgs/msg/ExecutorState", {"tick": 5}))
    assert values["tick"] == 5
    assert values["why_not_moving"] == ""
    assert len(values["feedback_age"]) == 0


def test_unknown_field_is_refused_by_name():
    with pytest.raises(CdrError, match="has no field positions"):
        pack("sensor_msgs/msg/JointState", {"positions": [1.0]})


def test_wrong_length_of_a_fixed_array_is_refused():
    with pytest.raises(CdrError, match="k must hold 9 values, got 8"):
        pack("sensor_msgs/msg/CameraInfo", {"k": [0.0] * 8})


def test_value_out_of_range_is_refused_by_field():
    with pytest.raises(CdrError, match=r"ExecutorState\.state"):
        pack("s2r_msgs/msg/ExecutorState", {"state": 300})


def test_every_truncation_is_refused():
    wire = pack("rcl_interfaces/msg/Log", {"name": "a", "msg": "hello", "level": 20})
    for length in range(len(wire)):
        with pytest.raises(CdrError):
            unpack("rcl_interfaces/msg/Log", wire[:length])


def test_an_impossible_length_is_refused_before_anything_is_allocated():
    wire = bytearray(pack("sensor_msgs/msg/JointState", {"name": ["a"]}))
    at = wire.index(b"\x01\x00\x00\x00\x02\x00\x00\x00a")
    wire[at : at + 4] = b"\xff\xff\xff\xff"
    with pytest.raises(CdrError, match="4294967295 elements do not fit"):
        unpack("sensor_msgs/msg/JointState", bytes(wire))


@pytest.mark.parametrize("has_effort", [True, False])
def test_block_encoder_gives_the_bytes_of_the_general_packer(has_effort):
    rng = np.random.default_rng(3)
    names = tuple(f"joint{i}" for i in range(1, 8))
    q, dq, tau = rng.normal(size=(3, 50, 7))
    stamps = rng.integers(0, 2**60, size=50)
    encoder = JointStateEncoder(names, frame_id="base", has_effort=has_effort)
    block = encoder.block(stamps, q, dq, tau if has_effort else None)
    for i, message in enumerate(block):
        expected = {
            "header": {
                "stamp": {"sec": int(stamps[i] // 10**9), "nanosec": int(stamps[i] % 10**9)},
                "frame_id": "base",
            },
            "name": list(names),
            "position": q[i],
            "velocity": dq[i],
            "effort": tau[i] if has_effort else [],
        }
        assert message == pack("sensor_msgs/msg/JointState", expected)


def test_block_encoder_refuses_missing_effort():
    encoder = JointStateEncoder(("a",))
    with pytest.raises(ValueError, match="needs effort"):
        encoder.block(np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1)))
