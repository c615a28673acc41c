"""ROS 2 messages without ROS: definitions, CDR packing, type hashes and rmw_zenoh keys."""

from s2r_protocol.ros2.cdr import CdrError, pack, unpack
from s2r_protocol.ros2.definitions import MessageType, message_type
from s2r_protocol.ros2.joint_states import JointStateEncoder
from s2r_protocol.ros2.keys import Attachment, topic_key
from s2r_protocol.ros2.rihs import type_hash
from s2r_protocol.ros2.times import nanoseconds

__all__ = [
    "Attachment",
    "CdrError",
    "JointStateEncoder",
    "MessageType",
    "message_type",
    "nanoseconds",
    "pack",
    "topic_key",
    "type_hash",
    "unpack",
]
