"""A recording in memory: topics with their messages, attachments and metadata."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from s2r_host.errors import RecordingError
from s2r_host.log.scan import Damage, Scan
from s2r_protocol.ros2 import JointStateEncoder, unpack

JOINT_STATE = "sensor_msgs/msg/JointState"
EXECUTOR_STATE = "s2r_msgs/msg/ExecutorState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
TEXT = "std_msgs/msg/String"
LOG = "rcl_interfaces/msg/Log"
IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


@dataclass
class Topic:
    """All messages of one topic. ``stamp_ns`` are log times, nanoseconds since the Unix epoch."""

    name: str
    type_name: str
    encoding: str
    stamp_ns: list[int] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)

    @property
    def short(self) -> str:
        """Last part of the name."""
        return self.name.rsplit("/", 1)[-1]


@dataclass(frozen=True, eq=False)
class Joints:
    """Joint states: ``stamp_ns`` (n,), ``q`` [rad], ``dq`` [rad/s], ``tau`` [N·m] or None, shape (n, dof)."""

    names: tuple[str, ...]
    stamp_ns: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray | None

    @property
    def t(self) -> np.ndarray:
        """Seconds since the first row, shape (n,)."""
        return (self.stamp_ns - self.stamp_ns[0]) * 1e-9


@dataclass
class Recording:
    """A recording in memory. Damage is not an error here: whoever needs a whole file looks at ``damage``."""

    path: Path
    profile: str
    damage: Damage
    topics: dict[str, Topic]
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    has_index: bool
    library: str = ""

    @property
    def is_foreign(self) -> bool:
        """Whether somebody else wrote it: then it may hold what we never write, and be as it should."""
        return not self.library.startswith("s2r")

    def of_type(self, type_name: str) -> list[Topic]:
        """Topics of one type, with messages."""
        return [t for t in self.topics.values() if t.type_name == type_name and t.messages]

    def topic(self, short: str, type_name: str) -> Topic:
        """The topic whose name ends with ``short``.

        Raises:
            RecordingError: There is none with messages.
        """
        for topic in self.of_type(type_name):
            if topic.short == short:
                return topic
        known = ", ".join(t.name for t in self.topics.values() if t.messages) or "none"
        raise RecordingError(
            f"{self.path} has no messages on a topic '…/{short}'; it has {known}. What the arm did is in it when the "
            "executor ran with --record DIR"
        )

    def has_references(self) -> bool:
        """Whether there are references, ``joint_commands``, for :meth:`joints`."""
        return any(topic.short == "joint_commands" for topic in self.of_type(JOINT_STATE))

    def joints(self, short: str = "joint_states") -> Joints:
        """Measured joints, or with ``joint_commands`` the references, in the order of their stamps.

        Raises:
            RecordingError: The topic is missing, or its joints change on the way.
        """
        return joints_of(self.topic(short, JOINT_STATE), str(self.path))

    def bodies(self, topic: Topic) -> list[Mapping[str, Any]]:
        """Every message of a topic, decoded."""
        return [unpack(topic.type_name, data) for data in topic.messages]


def read_recording(path: Path) -> Recording:
    """Read a whole file.

    Raises:
        RecordingError: It cannot be opened or is no MCAP file.
    """
    scan, channels = Scan(path), Channels()
    attachments: dict[str, bytes] = {}
    metadata: dict[str, dict[str, str]] = {}
    for record in scan.records():
        topic = channels.topic_of(record)
        match record:
            case Message() if topic is not None:
                topic.stamp_ns.append(record.log_time)
                topic.messages.append(record.data)
            case Attachment():
                attachments[record.name] = record.data
            case Metadata():
                metadata[record.name] = dict(record.metadata)
    return Recording(
        path,
        scan.profile,
        scan.damage,
        channels.topics,
        attachments,
        metadata,
        scan.has_index,
        scan.library,
    )


class Channels:
    """Which topic a message is of, learned from the records before it. ``topics`` by name, in the file's order."""

    def __init__(self) -> None:
        self.topics: dict[str, Topic] = {}
        self._schemas: dict[int, Schema] = {}
        self._by_id: dict[int, Topic] = {}

    def topic_of(self, record: Schema | Channel | Message | Attachment | Metadata) -> Topic | None:
        """The topic of a message; None of one whose channel was lost, and of every other record."""
        match record:
            case Schema():
                self._schemas.setdefault(record.id, record)
            case Channel() if record.id not in self._by_id:
                schema = self._schemas.get(record.schema_id)
                fresh = Topic(record.topic, schema.name if schema else "", record.message_encoding)
                self._by_id[record.id] = self.topics.setdefault(record.topic, fresh)
            case Message():
                return self._by_id.get(record.channel_id)
        return None


def joints_of(topic: Topic, who: str) -> Joints:
    """A JointState topic as arrays.

    Raises:
        RecordingError: Names or lengths change on the way.
    """
    first = unpack(JOINT_STATE, topic.messages[0])
    names = tuple(first["name"])
    has_effort = len(first["effort"]) > 0
    encoder = JointStateEncoder(names, first["header"]["frame_id"], has_effort)
    try:
        rows = encoder.rows(topic.messages)
    except ValueError as error:
        raise RecordingError(f"{who}: joints of {topic.name} change on the way: {error}") from error
    stamps = rows["sec"].astype(np.int64) * 1_000_000_000 + rows["nanosec"]
    order = np.argsort(stamps, kind="stable")
    tau = rows["effort"][order].copy() if has_effort else None
    return Joints(names, stamps[order], rows["position"][order].copy(), rows["velocity"][order].copy(), tau)
