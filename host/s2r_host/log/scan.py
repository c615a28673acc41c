"""Reading an MCAP file that may end anywhere or be damaged inside: everything readable, and what was not.

The file's own index is not used, so it need not be there. Where a chunk is damaged, the names that may have been in it
are taken from the summary at the file's end. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    Schema,
)
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from s2r_host.errors import RecordingError
from s2r_host.log.summary import repeated_names
from s2r_host.mcap_damage import DAMAGED


@dataclass
class Damage:
    """What could not be read.

    Attributes:
        truncated: The file ends without its closing record.
        unread_bytes: After the last readable record.
        chunks: Chunks that did not decompress or whose checksum is wrong, skipped.
        reason: Of the first problem.
    """

    truncated: bool = False
    unread_bytes: int = 0
    chunks: int = 0
    reason: str = ""

    @property
    def any(self) -> bool:
        """Whether anything is wrong."""
        return self.truncated or self.chunks > 0


@dataclass
class Scan:
    """An open scan: iterate :meth:`records` to its end, then look at ``damage``.

    Iterated again, it goes on behind the last whole record: for a file that grows, whose end is cut off until then.
    """

    path: Path
    damage: Damage = field(default_factory=Damage)
    profile: str = ""
    library: str = ""
    has_index: bool = False
    read_to: int = 0  # byte behind the last whole record
    _has_data_end: bool = False
    _has_footer: bool = False
    _bad_chunk: str = ""  # what is wrong with the first one

    def records(self) -> Iterator[Schema | Channel | Message | Attachment | Metadata]:
        """Every readable record in the file's order, from where it was read to before.

        In the place of the first damaged chunk come the schemas and channels of the file's summary: a recorder writes
        them once, most of them into the first chunk, and a message without its channel is of no use. So they may come
        again under a known id; the first of an id counts.

        Raises:
            RecordingError: The file cannot be opened or does not begin as an MCAP file.
        """
        if self._has_footer:
            return
        try:
            stream = self.path.open("rb")
        except OSError as error:
            raise RecordingError(f"recording {self.path}: {error.strerror}") from error
        with stream:
            size = self.path.stat().st_size
            stream.seek(self.read_to)
            reader = StreamReader(
                stream, skip_magic=self.read_to > 0, emit_chunks=True, record_size_limit=max(size, 1)
            )
            tail = ""
            try:
                for record in reader.records:
                    self.read_to = stream.tell()
                    self._has_footer = self._has_footer or isinstance(record, Footer)
                    self._has_data_end = self._has_data_end or isinstance(record, (DataEnd, Footer))
                    yield from self._content(record)
            except DAMAGED as error:
                if self.read_to == 0:
                    raise RecordingError(_nothing_readable(self.path, size)) from error
                tail = f"the record at byte {self.read_to} is cut off or damaged"
            self._judge_tail(tail, stream.seek(0, os.SEEK_END))  # it may have grown meanwhile

    def _judge_tail(self, reason: str, size: int) -> None:
        damage = self.damage
        damage.truncated = not self._has_data_end
        damage.unread_bytes = size - self.read_to if damage.truncated else 0
        if damage.truncated:
            reason = reason or "the file ends before its closing record"
        damage.reason = self._bad_chunk or reason

    def _content(self, record: McapRecord) -> Iterator[Schema | Channel | Message | Attachment | Metadata]:
        if isinstance(record, Chunk):
            try:
                inner = breakup_chunk(record, validate_crc=True)
            except DAMAGED as error:
                self.damage.chunks += 1
                if self.damage.chunks == 1:
                    self._bad_chunk = f"chunk: {error}"
                    yield from repeated_names(self.path)
                return
            yield from (r for r in inner if isinstance(r, (Schema, Channel, Message)))
        elif isinstance(record, Header):
            self.profile, self.library = record.profile, record.library
        elif isinstance(record, Footer):
            self.has_index = record.summary_start > 0
        elif isinstance(record, (Schema, Channel, Message, Attachment, Metadata)):
            yield record


def _nothing_readable(path: Path, size: int) -> str:
    """Why not even the first record of a file can be read."""
    with path.open("rb") as stream:
        first = stream.read(len(MCAP0_MAGIC))
    if first == MCAP0_MAGIC:
        return (
            f"{path} holds nothing readable: it is cut off or damaged in its first record, after {size} bytes"
        )
    return f"{path} is no MCAP recording: {f'it begins with {first!r}' if first else 'it is empty'}"
