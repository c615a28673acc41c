"""What travels between the front end and the process that writes recordings: length, JSON head, raw bytes.

No pickles: arrays go as ``.npy`` bytes (dtype included), everything else as JSON.
"""

from __future__ import annotations

import io
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
        more = connection.recv(min(count - len(parts), 1 << 20))
        if not more:
            return None
        parts += more
    return bytes(parts)


def batch_frame(batch: Batch) -> Frame:
    """A batch as bytes."""
    records = _array_bytes(batch.records)
    return Frame(
        {"kind": "batch", "holder": batch.holder, "split": len(records), "ticks": len(batch.records)},
        records + _array_bytes(batch.events),
    )


def batch_of(frame: Frame) -> Batch:
    """The batch of a frame."""
    split = int(frame.head["split"])
    return Batch(_array(frame.body[:split]), _array(frame.body[split:]), str(frame.head["holder"]))


def _array_bytes(values: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(values), allow_pickle=False)
    return stream.getvalue()


def _array(data: bytes) -> np.ndarray:
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
