"""The motions of a recording: which plan ran when, by the executor's own state messages."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from s2r_host.log.tables import EXECUTOR_STATE, TEXT, Recording
from s2r_protocol.faults import ExecutorState
from s2r_protocol.ros2 import nanoseconds, unpack

NOTES = "run"  # last part of their topic's name
ARM_STAMP = "arm_stamp_ns"  # in a note: stamp of the newest joint state when it was written
_STOPS = (ExecutorState.STOPPING, ExecutorState.STOP1, ExecutorState.FAULT, ExecutorState.ESTOP)


@dataclass(frozen=True)
class Segment:
    """One executed plan; times in nanoseconds since the Unix epoch.

    Attributes:
        seq: Its number.
        label: Its label, if known.
        begin_ns, end_ns: Its span.
        cut_ns: When a stop broke it off; None: it went to its end, or the recording ends before.
        reached_s: How far in the plan's own time it was recorded to come; None: the recording does not tell.
    """

    seq: int
    label: str
    begin_ns: int
    end_ns: int
    cut_ns: int | None = None
    reached_s: float | None = None


def segments(recording: Recording) -> list[Segment]:
    """Executed plans in the order of time; empty when the recording holds no executor states."""
    spans: dict[int, list[int]] = {}
    cuts: dict[int, int] = {}
    reached: dict[int, float] = {}
    for topic in recording.of_type(EXECUTOR_STATE):
        for data in topic.messages:
            body = unpack(EXECUTOR_STATE, data)
            seq = int(body["plan_seq"])
            if seq:
                stamp_ns = nanoseconds(body["header"]["stamp"])
                spans.setdefault(seq, []).append(stamp_ns)
                reached[seq] = max(float(body["plan_t"]), reached.get(seq, 0.0))
                if body["state"] in _STOPS and not body["plan_done"]:
                    cuts[seq] = min(stamp_ns, cuts.get(seq, stamp_ns))
    labels = plan_labels(recording)
    found = [
        Segment(seq, labels.get(seq, f"plan {seq}"), min(s), max(s), cuts.get(seq), reached[seq])
        for seq, s in spans.items()
    ]
    return sorted(found, key=lambda segment: segment.begin_ns)


def plan_labels(recording: Recording) -> dict[int, str]:
    """Sequence number -> label, from the host's notes or the executor's metadata."""
    labels = {int(note["seq"]): str(note["label"]) for note in notes(recording) if note["kind"] == "plan"}
    own = recording.metadata.get("s2r.plan")
    if own is not None:
        labels[int(own["seq"])] = own["label"]
    return labels


def notes(recording: Recording) -> list[dict]:
    """The host's notes of a run, in order."""
    return [
        note_of(data) for topic in recording.of_type(TEXT) if topic.short == NOTES for data in topic.messages
    ]


def note_of(data: bytes) -> dict:
    """One of the host's notes."""
    return json.loads(unpack(TEXT, data)["data"])


def inside(stamp_ns: np.ndarray, segment: Segment) -> np.ndarray:
    """Bool of shape (n,): which stamps lie in a segment."""
    return (stamp_ns >= segment.begin_ns) & (stamp_ns <= segment.end_ns)
