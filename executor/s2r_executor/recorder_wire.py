"""What travels between the front end and the process that writes recordings: length, JSON head, raw bytes.

No pickles: arrays go as raw bytes with their layout in the head, everything else as JSON.
"""

from __future__ import annotations

import json
import socket
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

_LENGTHS = struct.Struct("<II")
_MAX_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True)
class PlanIdentity:
    """Which plan a recording is of: the core's number, the host's number, epoch, sender and label."""

    plan_id: int
    seq: int
    epoch: int
    sender: str
    label: str


@dataclass(frozen=True, eq=False)
class Batch:
    """What one round of the watch loop took out of the core's rings."""

    records: np.ndarray
    events: np.ndarray
    holder: str


@dataclass(frozen=True)
class Frame:
    """One message: a JSON head with a ``kind``, and bytes."""

    head: dict[str, Any]
    body: bytes = b""


def send(connection: socket.socket, frame: Frame) -> None:
    """Write one frame; blocks while the peer's buffer is full.

    Raises:
        OSError: The peer has gone.
    """
    head = json.dumps(frame.head).encode()
    connection.sendall(_LENGTHS.pack(len(head), len(frame.body)) + head + frame.body)


def receive(connection: socket.socket) -> Frame | None:
    """Read one frame; None when the peer has closed or died, also in the middle of a frame.

    Raises:
        OSError: The connection is broken in another way, or its time is up.
        ValueError: The lengths are absurd.
    """
    lengths = _exactly(connection, _LENGTHS.size)
    if lengths is None:
        return None
    head_bytes, body_bytes = _LENGTHS.unpack(lengths)
    if head_bytes + body_bytes > _MAX_BYTES:
        raise ValueError(f"recorder frame of {head_bytes + body_bytes} bytes, limit {_MAX_BYTES}")
    head = _exactly(connection, head_bytes)
    body = _exactly(connection, body_bytes)
    if head is None or body is None:
        return None
    return Frame(json.loads(head), body)


def _exactly(connection: socket.socket, count: int) -> bytes | None:
    parts = bytearray()
    while len(parts) < count:
        try:
            more = connection.recv(min(count - len(parts), 1 << 20))
        except ConnectionResetError:  # it died without reading our answers: also an end
            return None
        if not more:
            return None
        parts += more
    return bytes(parts)


def batch_frame(batch: Batch) -> Frame:
    """A batch as bytes; the layouts travel along, the core's fields are not in the order of their offsets."""
    records, events = np.ascontiguousarray(batch.records), np.ascontiguousarray(batch.events)
    head = {
        "kind": "batch",
        "holder": batch.holder,
        "ticks": len(records),
        "split": records.nbytes,
        "layouts": [_layout(records.dtype), _layout(events.dtype)],
    }
    return Frame(head, records.tobytes() + events.tobytes())


def batch_of(frame: Frame) -> Batch:
    """The batch of a frame."""
    split = int(frame.head["split"])
    of_records, of_events = (_dtype(layout) for layout in frame.head["layouts"])
    return Batch(
        np.frombuffer(frame.body[:split], of_records),
        np.frombuffer(frame.body[split:], of_events),
        str(frame.head["holder"]),
    )


def merged(frames: list[Frame]) -> Frame:
    """Several batches of one sender as one; the holder is the last one's."""
    if len(frames) == 1:
        return frames[0]
    batches = [batch_of(frame) for frame in frames]
    records = [batch.records for batch in batches if len(batch.records)]
    events = [batch.events for batch in batches if len(batch.events)]
    return batch_frame(
        Batch(_joined(records, batches[0].records), _joined(events, batches[0].events), batches[-1].holder)
    )


def _joined(parts: list[np.ndarray], empty: np.ndarray) -> np.ndarray:
    if len(parts) < 2:
        return parts[0] if parts else empty
    joined = np.empty(sum(map(len, parts)), parts[0].dtype)
    begin = 0
    for part in parts:  # np.concatenate would repack the core's layout
        joined[begin : begin + len(part)] = part
        begin += len(part)
    return joined


def _layout(dtype: np.dtype) -> dict[str, Any]:
    """A structured dtype as JSON: name -> (base format, shape, offset); a plain one has no fields."""
    fields = {}
    for name, entry in (dtype.fields or {}).items():
        base, shape = entry[0].subdtype or (entry[0], ())
        fields[name] = [base.str, list(shape), entry[1]]
    return {"fields": fields, "itemsize": dtype.itemsize, "plain": "" if fields else dtype.str}


def _dtype(layout: dict[str, Any]) -> np.dtype:
    if layout["plain"]:
        return np.dtype(layout["plain"])
    fields = layout["fields"]
    return np.dtype(
        {
            "names": list(fields),
            "formats": [(base, tuple(shape)) if shape else base for base, shape, _ in fields.values()],
            "offsets": [offset for *_, offset in fields.values()],
            "itemsize": layout["itemsize"],
        }
    )
