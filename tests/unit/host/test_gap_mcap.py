"""MCAP files as ROS 2 writes them, packed by rosbags: other orders of joints, other senders, no stamps."""

import random

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.recordings.files import read_recording

ROS = get_typestore(Stores.ROS2_HUMBLE)
TYPE = "sensor_msgs/msg/JointState"
T = np.arange(200) * 0.01
BEGUN_S = 1_700_000_000


def message(t, names, q, stamped=True):
    types = ROS.types
    at = BEGUN_S * 10**9 + round(t * 1e9) if stamped else 0
    stamp = types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    values = np.array(q, dtype=float)
    return types[TYPE](
        header=header, name=list(names), position=values, velocity=values * 0, effort=values * 2
    )


def bag(folder, rows):
    """A ROS 2 bag of (topic, t [s], message); returns its MCAP file."""
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        names = sorted({topic for topic, _, _ in rows})
        topics = {topic: writer.add_connection(topic, TYPE, typestore=ROS) for topic in names}
        for topic, t, body in rows:
            at = BEGUN_S * 10**9 + round(t * 1e9)
            writer.write(topics[topic], at, ROS.serialize_cdr(body, TYPE))
    (path,) = (folder / "bag").glob("*.mcap")
    return path


def test_values_belong_to_the_joints_that_each_message_names(tmp_path):
    both = {"a": np.sin(T), "b": np.cos(T)}
    rows = []
    for i, t in enumerate(T):
        names = ["a", "b"] if i % 2 else ["b", "a"]
        rows.append(("/joint_states", t, message(t, names, [both[n][i] for n in names])))
    rec = read_recording(bag(tmp_path, rows))
    assert rec.get("q", "a") == pytest.approx(both["a"])
    assert rec.get("tau", "b") == pytest.approx(2 * both["b"])


def test_a_gripper_on_the_same_topic_does_not_mix_with_the_arm(tmp_path):
    rows = []
    for i, t in enumerate(T):
        rows.append(("/joint_states", t, message(t, ["finger"], [0.4])))
        rows.append(("/joint_states", t + 0.004, message(t + 0.004, ["a", "b"], [np.sin(T[i]), 0.1])))
    rec = read_recording(bag(tmp_path, rows))
    assert rec.get("q", "a") == pytest.approx(np.sin(T))
    assert rec.t == pytest.approx(T, abs=1e-9)


def test_without_stamps_the_recorders_time_counts_and_commands_are_set_on_it(tmp_path):
    rows = [("/arm/joint_states", t, message(t, ["a"], [np.sin(t)], stamped=False)) for t in T]
    rows += [
        ("/arm/joint_commands", t + 0.004, message(t, ["a"], [t + 0.004], stamped=False)) for t in T[:-1]
    ]
    rec = read_recording(bag(tmp_path, sorted(rows, key=lambda row: row[1])))
    assert rec.t == pytest.approx(T, abs=1e-9)
    assert rec.channels["q_cmd"]["a"][1:-1] == pytest.approx(T[1:-1], abs=1e-9)


def test_commands_that_come_more_rarely_than_states_leave_the_rows_beside_them(tmp_path):
    states = [("/joint_states", t, message(t, ["a"], [np.sin(3.0 * t)])) for t in T]
    commands = [
        ("/joint_commands", t, message(t, ["a"], [np.sin(3.0 * t)])) for t in np.arange(0.003, 1.99, 0.03)
    ]
    rec = read_recording(bag(tmp_path, sorted([*states, *commands], key=lambda row: row[1])))
    assert rec.t == pytest.approx(T[:199:3], abs=1e-9)
    assert rec.channels["q_cmd"]["a"][1:] == pytest.approx(np.sin(3.0 * rec.t[1:]), abs=2e-4)
    assert any("column 'q_cmd.a' holds numbers in 67 of 200 rows, 33.3 per second" in w for w in rec.warnings)


def test_a_bag_without_joint_states_is_refused(tmp_path):
    path = bag(tmp_path, [("/other", t, message(t, ["a"], [t])) for t in T])
    with pytest.raises(GapRecordingError, match="no topic"):
        read_recording(path)


def whole(path, compression, chunked=True):
    """An MCAP with the checksums that a writer may give it."""
    with path.open("wb") as stream:
        writer = McapWriter(
            stream,
            compression=compression,
            chunk_size=4000,
            use_chunking=chunked,
            enable_data_crcs=not chunked,
        )
        writer.start()
        schema = writer.register_schema(TYPE, "ros2msg", b"")
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for t in T:
            at = BEGUN_S * 10**9 + round(t * 1e9)
            data = bytes(ROS.serialize_cdr(message(t, ["a"], [np.sin(t)]), TYPE))
            writer.add_message(channel, at, data, at)
        writer.finish()
    return path.read_bytes()


def held(path):
    """What a recording holds, to the last bit; None where it is refused."""
    try:
        rec = read_recording(path)
    except GapRecordingError:
        return None
    return [
        rec.t.tobytes(),
        *(x.tobytes() for _, table in sorted(rec.channels.items()) for x in table.values()),
    ]


@pytest.mark.parametrize(
    ("compression", "chunked"),
    [
        (CompressionType.ZSTD, True),
        (CompressionType.LZ4, True),
        (CompressionType.NONE, True),
        (CompressionType.NONE, False),
    ],
)
def test_a_damaged_file_is_refused_or_holds_what_it_held(tmp_path, compression, chunked):
    path, rng = tmp_path / "r.mcap", random.Random(1)
    good = whole(path, compression, chunked)
    told = held(path)
    assert told is not None
    ends = (*range(300), *range(len(good) - 300, len(good)))
    for where in [rng.randrange(len(good)) for _ in range(120)] + rng.sample(ends, 60):
        damaged = bytearray(good)
        damaged[where] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        assert held(path) in (None, told), f"byte {where}"


def test_a_chunk_that_is_not_taken_for_one_is_missed(tmp_path):
    path = tmp_path / "r.mcap"
    damaged = bytearray(whole(path, CompressionType.ZSTD))
    at, chunks = 8, []  # records follow the magic bytes: kind, length, content
    while damaged[at] != Opcode.DATA_END:
        if damaged[at] == Opcode.CHUNK:
            chunks.append(at)
        at += 9 + int.from_bytes(damaged[at + 1 : at + 9], "little")
    damaged[chunks[-1]] |= 0x80
    path.write_bytes(damaged)
    with pytest.raises(GapRecordingError, match=r"messages can be read of 200"):
        read_recording(path)
