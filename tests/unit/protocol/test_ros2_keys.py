"""Type hashes and rmw_zenoh keys against published values."""

from __future__ import annotations

import struct

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from s2r_protocol.ros2 import Attachment, topic_key, type_hash
from s2r_protocol.ros2.definitions import all_names, message_type, parse
from s2r_protocol.ros2.keys import node_token, publisher_token

JOINT_STATE_HASH = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"


def test_joint_state_has_the_published_type_hash():
    assert type_hash("sensor_msgs/msg/JointState") == JOINT_STATE_HASH


@pytest.mark.parametrize("name", all_names())
def test_type_hashes_agree_with_rosbags(name):
    store = get_typestore(Stores.ROS2_JAZZY)
    if name.startswith("s2r_msgs"):
        store.register(get_types_from_msg(message_type(name).text, name))
    assert type_hash(name) == store.hash_rihs01(name)


def test_topic_key_follows_rmw_zenoh():
    key = topic_key("/lab/xmate3pro/joint_states", "sensor_msgs/msg/JointState", domain=3)
    assert key == f"3/lab/xmate3pro/joint_states/sensor_msgs::msg::dds_::JointState_/{JOINT_STATE_HASH}"


def test_topic_with_an_empty_part_is_refused():
    with pytest.raises(ValueError, match="empty part"):
        topic_key("/lab//joint_states", "sensor_msgs/msg/JointState")


def test_liveliness_tokens_have_the_parts_rmw_zenoh_expects():
    node = node_token("abc", "s2r_executor", "/lab/xmate3pro")
    assert node == "@ros2_lv/0/abc/0/0/NN/%/%lab%xmate3pro/s2r_executor"
    publisher = publisher_token("abc", 2, "n", "/lab/x/joint_states", "sensor_msgs/msg/JointState", "/lab/x")
    assert publisher.split("/")[:8] == ["@ros2_lv", "0", "abc", "0", "2", "MP", "%", "%lab%x"]
    assert publisher.split("/")[9] == "%lab%x%joint_states"


@pytest.mark.parametrize(("labelled", "size"), [(False, 33), (True, 77)])
def test_attachment_layouts_have_their_known_sizes(labelled, size):
    packed = Attachment(sequence=5, stamp_ns=123, gid=bytes(range(16))).pack(labelled)
    assert len(packed) == size
    assert packed.endswith(bytes([16]) + bytes(range(16)))


def test_attachment_begins_with_sequence_and_time():
    packed = Attachment(sequence=-2, stamp_ns=99, gid=bytes(16)).pack()
    assert struct.unpack("<qq", packed[:16]) == (-2, 99)


def test_attachment_refuses_a_short_publisher_id():
    with pytest.raises(ValueError, match="16 bytes, got 3"):
        Attachment(1, 1, b"abc").pack()


def test_unreadable_definition_line_is_refused_with_its_number():
    with pytest.raises(ValueError, match="line 2"):
        parse("a/msg/B", "int32 x\n!!\n")
