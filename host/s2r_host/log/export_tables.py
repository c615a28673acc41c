"""``s2r log export --to parquet | csv``: one table per topic."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from s2r_host.errors import RecordingError
from s2r_host.log.tables import Recording, table_of


def export_tables(recording: Recording, folder: Path, kind: str) -> tuple[list[Path], list[str]]:
    """Write every topic that is a table.

    Args:
        recording: What to write.
        folder: Made if missing.
        kind: ``parquet`` or ``csv``.

    Returns:
        Files written, and names of topics that are no tables (images, unknown types).

    Raises:
        RecordingError: A message cannot be decoded, or no topic is a table; then there is no folder either.
    """
    written, left_out = [], []
    stems = _file_stems([topic.name for topic in recording.topics.values() if topic.messages])
    for topic in recording.topics.values():
        if not topic.messages:
            continue
        columns = table_of(topic, str(recording.path))
        if columns is None:
            left_out.append(topic.name)
            continue
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{stems[topic.name]}.{kind}"
        table = pa.table({name: pa.array(values) for name, values in columns.items()})
        if kind == "parquet":
            facts = {
                "s2r.topic": topic.name,
                "s2r.type": topic.type_name,
                "s2r.source": recording.path.name,
            }
            pa.parquet.write_table(table.replace_schema_metadata(facts), path, compression="zstd")
        else:
            pa.csv.write_csv(table, path)
        written.append(path)
    if not written:
        there = (
            f"it has {', '.join(left_out)}, of which none is a table" if left_out else "it has no messages"
        )
        raise RecordingError(f"nothing of {recording.path} can be written as {kind}: {there}")
    return written, left_out


def _file_stems(topics: list[str]) -> dict[str, str]:
    """File name of each topic: without cell and arm, unless topics of several would be one file."""
    whole = {topic: topic.strip("/").replace("/", "__") for topic in topics}
    short = {topic: "__".join(topic.strip("/").split("/")[2:]) or whole[topic] for topic in topics}
    return short if len(set(short.values())) == len(topics) else whole


def parquet_joints(path: Path) -> dict[str, np.ndarray]:
    """A joint table read back: column name -> values; for notebooks and tests."""
    table = pa.parquet.read_table(path)
    return {name: table[name].to_numpy() for name in table.column_names}
