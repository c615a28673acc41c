"""MCAP files of this project or of ROS 2: JointState messages in CDR, measured and commanded."""

from __future__ import annotations

import os
from collections import defaultdict
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Message

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.recordings.coarse_columns import COARSE, between
from s2r_host.mcap_damage import DAMAGED
from s2r_protocol.ros2 import nanoseconds, unpack

JOINT_STATE = "sensor_msgs/msg/JointState"
MEASURED = {"position": "q", "velocity": "dq", "effort": "tau"}
COMMANDED = {"position": "q_cmd", "velocity": "dq_cmd", "effort": "tau_ff"}


class _Message(NamedTuple):
    """One JointState with its two times [ns]: the sender's, zero where it gives none, and the recorder's."""

    stamp: int
    logged: int
    values: dict


def read_mcap(path: Path) -> dict[str, np.ndarray]:
    """Columns of the contract from the topics ``.../joint_states`` and ``.../joint_commands``.

    Where several senders share a topic, as arm and gripper do in ROS, those of most values are taken: what the others
    say belongs to other moments. Senders without a clock count by the recorder's. Commands that come more rarely than
    states stand in the row next to each.

    Raises:
        GapRecordingError: Not an MCAP, a damaged one, or no joint states in it.
    """
    tracks: dict[str, list[_Message]] = {"joint_states": [], "joint_commands": []}
    try:
        with path.open("rb") as stream:
            for topic, message in _joint_states(stream):
                if topic in tracks:
                    values = unpack(JOINT_STATE, message.data)
                    sent = nanoseconds(values["header"]["stamp"])
                    tracks[topic].append(_Message(sent, message.log_time, values))
    except (*DAMAGED, OSError, LookupError) as error:  # the last from CDR that is none
        why = str(error) or type(error).__name__
        raise GapRecordingError(f"{path.name}: no MCAP with joint states in CDR ({why})") from error
    if not tracks["joint_states"]:
        raise GapRecordingError(f"{path.name}: no topic '.../joint_states' with {JOINT_STATE} messages")
    at, measured = _columns(tracks["joint_states"], MEASURED)
    t = 1e-9 * (at - at[0])  # in whole nanoseconds: a date in seconds leaves a quarter of a microsecond
    table = {"t": t, **measured}
    if len(tracks["joint_commands"]) > 1:
        at_cmd, commanded = _columns(tracks["joint_commands"], COMMANDED)
        t_cmd = 1e-9 * (at_cmd - at[0])
        t_cmd, order = np.unique(t_cmd, return_index=True)
        for name, values in commanded.items():
            table[name] = _beside_states(name, t_cmd, values[order], t)
    return table


def _joint_states(stream: BinaryIO) -> list[tuple[str, Message]]:
    """All messages with joint states of a file that is whole, by the recorder's time, with the last part of the topic.

    Raises:
        ValueError: A checksum is wrong, or the file holds fewer or more messages than it says.
        Others of :data:`s2r_host.mcap_damage.DAMAGED`.
    """
    size = stream.seek(0, os.SEEK_END)
    summary = SeekingReader(_from_start(stream), record_size_limit=size).get_summary()
    reader = NonSeekingReader(_from_start(stream), validate_crcs=True, record_size_limit=size)
    found, count = [], 0
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        count += 1
        if schema is not None and schema.name == JOINT_STATE:
            found.append((channel.topic.rsplit("/", 1)[-1], message))
    # A chunk whose first byte is wrong is one of an unknown kind to a reader, and would be skipped.
    told = None if summary is None else summary.statistics
    if told is not None and told.message_count != count:
        raise ValueError(f"{count} messages can be read of {told.message_count}")
    return sorted(found, key=lambda one: one[1].log_time)


def _from_start(stream: BinaryIO) -> BinaryIO:
    stream.seek(0)
    return stream


def _beside_states(column: str, t_cmd: np.ndarray, x: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Commands at the times of the states, shape (rows,); of rarer ones in the row next to each alone, else NaN."""
    if len(t_cmd) < 2 or np.median(np.diff(t_cmd)) <= COARSE * np.median(np.diff(t)):
        return np.interp(t, t_cmd, x)
    rows = np.unique(np.searchsorted(0.5 * (t[1:] + t[:-1]), t_cmd))
    found = np.full(len(t), np.nan)
    found[rows] = between(column, t_cmd, x, t[rows])
    return found


def _columns(messages: list[_Message], names: dict[str, str]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times [ns] and columns of those messages that name the same joints, in whatever order each names them."""
    senders: dict[frozenset[str], list[_Message]] = defaultdict(list)
    for message in messages:
        senders[frozenset(message.values["name"])].append(message)
    joints, own = max(senders.items(), key=lambda item: len(item[0]) * len(item[1]))
    stamped = any(message.stamp > 0 for message in own)
    at = np.array([message.stamp if stamped else message.logged for message in own], dtype=np.int64)
    table: dict[str, np.ndarray] = {}
    for field, kind in names.items():
        if any(len(message.values[field]) != len(joints) for message in own):
            continue
        rows = [dict(zip(message.values["name"], message.values[field], strict=True)) for message in own]
        for joint in sorted(joints):
            table[f"{kind}.{joint}"] = np.array([row[joint] for row in rows], dtype=float)
    return at, table
