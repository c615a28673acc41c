"""When the host's notes, plans and pictures of a run were, on the clock of the arm.

Joint states have the core's time, what the host writes its own: in lock-step the core's stands still while the host
thinks, and on two machines the clocks differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from s2r_host.log.segments import ARM_STAMP, NOTES, Segment, notes, segments
from s2r_host.log.tables import CAMERA_INFO, IMAGE, JOINT_STATE, TEXT, TRAJECTORY, Recording


def arm_times(recording: Recording) -> dict[str, np.ndarray]:
    """Of every topic of the host the time of each message [ns], as joint states have it; without those where unknown.

    A note tells it. Of an older file, or where the executor was silent, the order of the notes does: what was seen
    after a motion is placed at its end, unless the host's own times are in that order, too.
    """
    joints = recording.of_type(JOINT_STATE)
    own = [topic for topic in recording.of_type(TEXT) if topic.short == NOTES]
    if recording.is_foreign or not joints or len(own) != 1:
        return {}
    told = notes(recording)
    begin_ns = min(min(topic.stamp_ns) for topic in joints)
    of_notes = _of_notes(told, own[0].stamp_ns, segments(recording), begin_ns)
    kinds = np.array([note["kind"] for note in told])
    found = {own[0].name: of_notes}
    for type_name, kind in ((TRAJECTORY, "plan"), (IMAGE, "view"), (CAMERA_INFO, "view")):
        times = of_notes[kinds == kind]
        found |= {t.name: times for t in recording.of_type(type_name) if len(t.messages) == len(times)}
    return found


def _of_notes(
    told: Sequence[dict[str, Any]], host_ns: Sequence[int], found: Sequence[Segment], begin_ns: int
) -> np.ndarray:
    """Time of each note [ns], shape (n,); ``host_ns`` by the host's clock, ``begin_ns`` of the first joint state."""
    by_seq = {segment.seq: segment for segment in found}
    motions = [by_seq.get(note["seq"]) if note["kind"] == "plan" else None for note in told]
    known = [note.get(ARM_STAMP) for note in told]
    times = _by_order(motions, begin_ns)
    if any(at is not None for at in known):
        times = [rest if at is None else at for rest, at in zip(times, known, strict=True)]
        return np.maximum.accumulate(np.array(times, np.int64))  # notes are written one after the other
    views = [i for i, note in enumerate(told) if note["kind"] == "view"]
    one_clock = views and all(_between(motions[:i], host_ns[i], motions[i:]) for i in views)
    return np.array(host_ns if one_clock else times, np.int64)


def _between(before: Sequence[Segment | None], at_ns: int, after: Sequence[Segment | None]) -> bool:
    """Whether a time lies behind the motions before it and before those after it."""
    return all(m is None or m.end_ns <= at_ns for m in before) and all(
        m is None or at_ns <= m.begin_ns for m in after
    )


def _by_order(motions: Sequence[Segment | None], begin_ns: int) -> list[int]:
    """Begin of each note's own motion, or else the end of the last motion before it [ns]; before any, ``begin_ns``."""
    times, rest_ns = [], begin_ns
    for motion in motions:
        times.append(rest_ns if motion is None else motion.begin_ns)
        rest_ns = rest_ns if motion is None else motion.end_ns
    return times
