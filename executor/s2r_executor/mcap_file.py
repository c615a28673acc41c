"""One MCAP recording: profile ``ros2``, only CDR messages, readable by rosbags, Rerun and Foxglove as it is."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, cast

from mcap.writer import CompressionType, Writer

from s2r_executor.observations import RECORDED, Topic
from s2r_protocol.ros2.definitions import message_type, schema_text
from s2r_protocol.ros2.rihs import type_hash


class McapFile:
    """A recording being written. Its chunks are small and flushed, so that a crash costs at most half a second.

    Args:
        path: Written anew.
        namespace: Of the topics, e.g. ``/lab/xmate3pro``.
        chunk_bytes: Uncompressed size after which a chunk is closed.
    """

    def __init__(self, path: Path, namespace: str, chunk_bytes: int) -> None:
        self.path = path
        self._stream = _Sink(path)
        sink = cast("IO[bytes]", self._stream)  # all that the writer asks of it
        self._writer = Writer(sink, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="s2r")
        self._channels: dict[Topic, int] = {}
        self._counts: dict[Topic, int] = {}
        schemas: dict[str, int] = {}
        for topic in RECORDED:
            name = topic.type_name
            if name not in schemas:
                schemas[name] = self._writer.register_schema(name, "ros2msg", schema_text(name).encode())
            self._channels[topic] = self._writer.register_channel(
                topic=f"{namespace}/{topic.name}",
                message_encoding="cdr",
                schema_id=schemas[name],
                metadata={
                    "offered_qos_profiles": "",
                    "topic_type_hash": type_hash(name),
                    "type": message_type(name).name,
                },
            )
            self._counts[topic] = 0
        self.messages = 0

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add a file to the recording."""
        now = time.time_ns()
        self._writer.add_attachment(
            create_time=now, log_time=now, name=name, media_type=media_type, data=data
        )

    def describe(self, name: str, values: dict[str, str]) -> None:
        """Add named values to the recording."""
        self._writer.add_metadata(name, values)

    def add(self, topic: Topic, stamps_ns: Sequence[int], messages: Sequence[bytes]) -> None:
        """Add messages of one topic, oldest first."""
        channel, count = self._channels[topic], self._counts[topic]
        for offset, (stamp, data) in enumerate(zip(stamps_ns, messages, strict=True)):
            self._writer.add_message(channel, stamp, data, stamp, sequence=(count + offset) & 0xFFFFFFFF)
        self._counts[topic] = count + len(messages)
        self.messages += len(messages)

    def flush(self) -> None:
        """Close the open chunk and hand everything to the kernel."""
        self._writer.flush()
        self._stream.flush()

    def abandon(self) -> None:
        """Close the file as it is, without its index, when nothing more can be written."""
        self._stream.abandon()

    def close(self) -> None:
        """Write the index and close."""
        self._writer.finish()
        self._stream.close()


class _Sink:
    """The stream below the writer: flush() means that the kernel has the bytes; it can be closed on a full disk."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        self._held = bytearray()
        self._position = 0

    def write(self, data: bytes) -> int:
        self._held += data
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        while self._held:
            written = self._file.write(self._held)
            del self._held[:written]

    def close(self) -> None:
        self.flush()
        self._file.close()

    def abandon(self) -> None:
        self._held.clear()
        self._file.close()
