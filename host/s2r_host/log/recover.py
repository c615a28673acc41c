"""``s2r log recover``: everything readable of a damaged or cut recording, in a new and complete file."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from s2r_host.errors import RecordingError
from s2r_host.log.scan import Damage, Scan


@dataclass(frozen=True)
class Recovered:
    """What a recovery brought back.

    Attributes:
        path: Of the new file.
        messages: In the new file.
        attachments: In the new file.
        orphans: Messages whose channel was lost with a damaged chunk, and in the summary too: nobody can tell of what
            they are, so they are not in the new file.
        first_ns, last_ns: Log times of the first and last message, 0 without one.
        damage: What could not be read.
    """

    path: Path
    messages: int
    attachments: int
    orphans: int
    first_ns: int
    last_ns: int
    damage: Damage


def recover(source: Path, target: Path) -> Recovered:
    """Copy every readable record of ``source`` into ``target``, which appears only when it is complete.

    Raises:
        RecordingError: Source is no MCAP file, nothing of it can be saved, or there is nothing in it; or target exists.
    """
    if target.exists():
        raise RecordingError(f"{target} exists; name another file with --out")
    scan = Scan(source)
    part = target.with_name(target.name + ".part")
    try:
        with part.open("wb") as stream:
            found = _copy(scan, Writer(stream, compression=CompressionType.ZSTD), target)
        if found.damage.any and not found.messages and not found.attachments:
            raise RecordingError(
                f"nothing of {source} could be saved: {_what_is_lost(found, source.stat().st_size)} "
                f"({found.damage.reason}), so {target} was not written; look for a copy of the recording"
            )
        if not found.messages and not found.attachments:
            raise RecordingError(f"{source} is whole and holds nothing to save, so {target} was not written")
        os.replace(part, target)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            part.unlink()
        raise
    return found


def _what_is_lost(found: Recovered, size: int) -> str:
    """Why there is nothing to save in a damaged file of ``size`` bytes."""
    if found.orphans:
        return f"the names of the topics of its {found.orphans} messages are lost"
    return f"no message and no attachment of its {size} bytes is readable"


def _copy(scan: Scan, writer: Writer, target: Path) -> Recovered:
    """Copy what can be read; ``target`` is where it is going to be."""
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    messages = attachments = orphans = last = 0
    first: int | None = None
    begun = False
    for record in scan.records():
        if not begun:  # the header comes first, so the profile is known now
            writer.start(profile=scan.profile, library="s2r log recover")
            begun = True
        match record:
            case Schema():
                if record.id not in schemas:
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            case Channel():
                if record.id not in channels and record.schema_id in schemas:
                    channels[record.id] = writer.register_channel(
                        record.topic,
                        record.message_encoding,
                        schemas[record.schema_id],
                        dict(record.metadata),
                    )
            case Message() if record.channel_id not in channels:
                orphans += 1
            case Message():
                writer.add_message(
                    channels[record.channel_id],
                    record.log_time,
                    record.data,
                    record.publish_time,
                    record.sequence,
                )
                messages += 1
                first = record.log_time if first is None else min(first, record.log_time)
                last = max(last, record.log_time)
            case Attachment():
                writer.add_attachment(
                    record.create_time, record.log_time, record.name, record.media_type, record.data
                )
                attachments += 1
            case Metadata():
                writer.add_metadata(record.name, dict(record.metadata))
    if not begun:
        writer.start(profile=scan.profile, library="s2r log recover")
    writer.finish()
    return Recovered(target, messages, attachments, orphans, first or 0, last, scan.damage)
