"""``s2r log check``: is a recording whole, and does it hold what it claims?"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.log.tables import JOINT_STATE, Recording, Topic, joints_of, read_recording
from s2r_protocol.ros2 import CdrError, unpack
from s2r_protocol.ros2.cdr import HEADER
from s2r_protocol.ros2.definitions import UnknownMessageTypeError, message_type

_STEADY_MESSAGES = 10
_STEADY_SHARE = 0.2  # of the usual period: half of all gaps of a stream differ by less
_GAP = 5.0  # a pause of this many usual periods is worth a line


@dataclass(frozen=True)
class TopicFacts:
    """One topic: how many messages, over what time, how regular. ``rate_hz`` is None where they come as it happens."""

    name: str
    type_name: str
    messages: int
    duration_s: float
    rate_hz: float | None
    longest_gap_s: float


@dataclass(frozen=True)
class Checked:
    """The answer. ``problems`` make the file unfit as it is; ``notes`` are worth knowing."""

    path: Path
    topics: list[TopicFacts]
    attachments: list[str]
    metadata: dict[str, dict[str, str]]
    problems: list[str]
    notes: list[str]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "path": str(self.path)}


def check(path: Path) -> Checked:
    """Read everything once and decode every message that is of a type we know.

    What only our own recordings promise (CDR, an index, one set of joints with finite numbers) is a note in others'.

    Raises:
        RecordingError: It cannot be opened or is no MCAP file.
    """
    recording = read_recording(path)
    problems, notes = _whole(recording), []
    promised = notes if recording.is_foreign else problems
    if not recording.damage.truncated and not recording.has_index:
        promised.append("no index: readers that seek will refuse it; 's2r log recover' writes one")
    if recording.profile != "ros2":
        notes.append(f"profile is {recording.profile!r}, not 'ros2': ROS 2 tools may not open it")
    facts = []
    for topic in recording.topics.values():
        if not topic.messages:
            continue
        facts.append(_facts(topic))
        rate_hz = facts[-1].rate_hz or 0.0
        if rate_hz > 50 and facts[-1].longest_gap_s > _GAP / rate_hz:
            notes.append(f"{topic.name}: longest gap {facts[-1].longest_gap_s:.3f} s at {rate_hz:.0f} Hz")
        if topic.encoding != "cdr":
            promised.append(
                f"{topic.name}: messages are {topic.encoding!r}, not CDR; they are not looked into"
            )
        elif recording.is_foreign and any(data[:4] != HEADER for data in topic.messages):
            notes.append(
                f"{topic.name}: messages are CDR of another form than ROS 2 writes; they are not looked into"
            )
        else:
            problems += _undecodable(topic)
    if not facts:
        promised.append("no messages")
    promised += _numbers(recording)
    if "s2r" not in recording.metadata:
        notes.append("no 's2r' metadata: arm, hashes and versions are unknown")
    return Checked(path, facts, sorted(recording.attachments), recording.metadata, problems, notes)


def _whole(recording: Recording) -> list[str]:
    found, damage = [], recording.damage
    if damage.truncated:
        found.append(
            f"cut off: {damage.unread_bytes} bytes after the last whole record ({damage.reason}); "
            "mend it with 's2r log recover', unless its recorder still writes it: check again once that has ended"
        )
    if damage.chunks:
        found.append(f"{damage.chunks} damaged chunks ({damage.reason}); 's2r log recover' saves the rest")
    return found


def _facts(topic: Topic) -> TopicFacts:
    stamps = np.sort(np.array(topic.stamp_ns, np.int64))
    duration = float(stamps[-1] - stamps[0]) * 1e-9
    gaps = np.diff(stamps) * 1e-9
    return TopicFacts(
        topic.name,
        topic.type_name,
        len(stamps),
        duration,
        _rate_hz(gaps),
        float(gaps.max()) if len(gaps) else 0.0,
    )


def _rate_hz(gaps_s: np.ndarray) -> float | None:
    """Messages a second of a steady stream; None for events, which have no rate."""
    if len(gaps_s) < _STEADY_MESSAGES:
        return None
    # The median, not the mean: a file of several motions has pauses between them.
    period_s = float(np.median(gaps_s))
    if period_s <= 0.0 or np.mean(np.abs(gaps_s - period_s) < _STEADY_SHARE * period_s) < 0.5:
        return None
    return 1.0 / period_s


def _undecodable(topic: Topic) -> list[str]:
    try:
        message_type(topic.type_name)
    except (UnknownMessageTypeError, ValueError):
        return []  # somebody else's topic: not ours to judge
    bad = 0
    for data in topic.messages:
        try:
            unpack(topic.type_name, data)
        except CdrError:
            bad += 1
    return [f"{topic.name}: {bad} of {len(topic.messages)} messages cannot be decoded"] if bad else []


def _numbers(recording: Recording) -> list[str]:
    found = []
    for topic in recording.of_type(JOINT_STATE):
        if topic.encoding != "cdr":
            continue
        try:
            joints = joints_of(topic, str(recording.path))
        except (RecordingError, CdrError) as error:
            found.append(str(error))
            continue
        for label, values in (("positions", joints.q), ("velocities", joints.dq), ("efforts", joints.tau)):
            if values is not None and not np.isfinite(values).all():
                found.append(f"{topic.name}: {label} hold NaN or infinity")
    return found
