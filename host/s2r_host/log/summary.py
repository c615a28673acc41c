"""The names of schemas and channels that an MCAP file repeats in the summary at its end."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from pathlib import Path

from mcap.reader import FOOTER_SIZE
from mcap.records import Channel, Footer, McapRecord, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader

from s2r_host.mcap_damage import DAMAGED

_CRC_BYTES = 4  # the last field of the footer


def repeated_names(path: Path) -> list[Schema | Channel]:
    """All schemas and then all channels of the summary.

    None where there is no summary, the file is cut off, or the summary has no checksum or another one: a name in which
    a bit has flipped is worse than no name.
    """
    try:
        records = list(_summary(path))
    except (OSError, *DAMAGED):  # then it has no end that can be read
        return []
    schemas = [record for record in records if isinstance(record, Schema)]
    channels = [record for record in records if isinstance(record, Channel)]
    return [*schemas, *channels]


def _summary(path: Path) -> Iterator[McapRecord]:
    """Records from the summary's begin to the footer; empty when its checksum is not what the footer says."""
    with path.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(-(FOOTER_SIZE + MAGIC_SIZE), os.SEEK_END)
        footer = next(StreamReader(stream, skip_magic=True, record_size_limit=size).records)
        if not isinstance(footer, Footer) or footer.summary_start == 0 or footer.summary_crc == 0:
            return
        stream.seek(footer.summary_start)
        content = stream.read(max(0, size - MAGIC_SIZE - _CRC_BYTES - footer.summary_start))
        if zlib.crc32(content) == footer.summary_crc:
            stream.seek(footer.summary_start)
            yield from StreamReader(stream, skip_magic=True, record_size_limit=size).records
