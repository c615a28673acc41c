"""Where a ROS 2 topic lives on Zenoh, as rmw_zenoh defines it (ros2/rmw_zenoh, docs/design.md).

Topic key: ``<domain>/<topic without leading slash>/<DDS type name>/<type hash>``.
Every put carries an attachment with sequence number, source time and the publisher's 16-byte id;
a liveliness token per node and publisher makes ``ros2 topic list`` show them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from s2r_protocol.ros2.definitions import message_type
from s2r_protocol.ros2.rihs import type_hash

_LIVELINESS = "@ros2_lv"
_DEFAULT_QOS = "::,10:,:,:,,"  # reliable, volatile, keep last 10; empty parts mean the default


def topic_key(topic: str, type_name: str, domain: int = 0) -> str:
    """Key expression of a topic, e.g. ``0/lab/xmate3pro/joint_states/sensor_msgs::msg::dds_::JointState_/RIHS01_...``.

    Raises:
        ValueError: The topic is empty or has empty parts.
    """
    parts = topic.strip("/").split("/")
    if not all(parts):
        raise ValueError(f"topic {topic!r} has an empty part")
    return f"{domain}/{'/'.join(parts)}/{message_type(type_name).dds_name}/{type_hash(type_name)}"


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"


def node_token(zenoh_id: str, node: str, namespace: str = "/", domain: int = 0) -> str:
    """Liveliness token of a node; ``namespace`` begins with a slash."""
    return f"{_LIVELINESS}/{domain}/{zenoh_id}/0/0/NN/%/{_mangled(namespace)}/{node}"


def publisher_token(
    zenoh_id: str, entity: int, node: str, topic: str, type_name: str, namespace: str = "/", domain: int = 0
) -> str:
    """Liveliness token of a publisher; ``topic`` is absolute, ``entity`` counts the node's endpoints."""
    return _endpoint_token("MP", zenoh_id, entity, node, topic, type_name, namespace, domain)


def subscription_token(
    zenoh_id: str, entity: int, node: str, topic: str, type_name: str, namespace: str = "/", domain: int = 0
) -> str:
    """Liveliness token of a subscription, arguments as of a publisher's."""
    return _endpoint_token("MS", zenoh_id, entity, node, topic, type_name, namespace, domain)


def _endpoint_token(
    kind: str, zenoh_id: str, entity: int, node: str, topic: str, type_name: str, namespace: str, domain: int
) -> str:
    dds = message_type(type_name).dds_name
    where = f"{_LIVELINESS}/{domain}/{zenoh_id}/0/{entity}/{kind}/%/{_mangled(namespace)}/{node}"
    return f"{where}/{_mangled(topic)}/{dds}/{type_hash(type_name)}/{_DEFAULT_QOS}"


@dataclass(frozen=True)
class Attachment:
    """What rmw_zenoh puts beside every message.

    Attributes:
        sequence: Counts the publisher's messages from 1.
        stamp_ns: Source time, nanoseconds since the Unix epoch.
        gid: 16 bytes, constant per publisher.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def pack(self, labelled: bool = False) -> bytes:
        """The bytes; ``labelled`` selects the layout of Jazzy and earlier, which names each value."""
        if len(self.gid) != 16:
            raise ValueError(f"a publisher id has 16 bytes, got {len(self.gid)}")
        parts = (
            ("sequence_number", struct.pack("<q", self.sequence)),
            ("source_timestamp", struct.pack("<q", self.stamp_ns)),
            ("source_gid", bytes([16]) + self.gid),
        )
        if not labelled:
            return b"".join(value for _, value in parts)
        return b"".join(bytes([len(label)]) + label.encode("ascii") + value for label, value in parts)
