"""``s2r log export --to parquet | csv``: one table per topic."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from s2r_host.errors import RecordingError
from s2r_host.log.arm_time import arm_times
from s2r_host.log.columns import table_of
from s2r_host.log.tables import Recording
from s2r_protocol.whole_file import write_whole

LIST = "_export.json"
"""What an export wrote, so that the next one can take it away. Readers of a folder of tables pass over such a name."""


def export_tables(recording: Recording, folder: Path, kind: str) -> tuple[list[Path], list[str]]:
    """Write every topic that is a table; tables of an earlier export in the folder go.

    Args:
        recording: What to write.
        folder: Made if missing.
        kind: ``parquet`` or ``csv``.

    Returns:
        Files written, and what is in none of them: names of topics that are no tables (images, unknown types), and of
        arrays too long to be columns as ``topic: array``.

    Raises:
        RecordingError: A message cannot be decoded, or no topic is a table; then there is no folder either.
    """
    written, left_out = [], []
    topics = [topic for topic in recording.topics.values() if topic.messages]
    stems = _file_stems([topic.name for topic in topics])
    on_arm = arm_times(recording)
    for topic in topics:
        found = table_of(topic, str(recording.path), on_arm.get(topic.name))
        if found is None:
            left_out.append(topic.name)
            continue
        left_out += [f"{topic.name}: {name}" for name in found.left_out]
        if not written:
            folder.mkdir(parents=True, exist_ok=True)
            _take_away(folder)
        path = folder / f"{stems[topic.name]}.{kind}"
        table = pa.table({name: pa.array(values) for name, values in found.columns.items()})
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
        _list(folder, written)
    if not written:
        there = (
            f"it has {', '.join(left_out)}, of which none is a table" if left_out else "it has no messages"
        )
        raise RecordingError(f"nothing of {recording.path} can be written as {kind}: {there}")
    return written, left_out


def _take_away(folder: Path) -> None:
    """Remove what an earlier export wrote, and nothing else."""
    try:
        names = json.loads((folder / LIST).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):  # none, or of somebody else
        return
    for name in names:
        if isinstance(name, str) and Path(name).name == name:
            (folder / name).unlink(missing_ok=True)


def _list(folder: Path, written: list[Path]) -> None:
    write_whole(folder / LIST, json.dumps({"files": [path.name for path in written]}, indent=1) + "\n")


def _file_stems(topics: list[str]) -> dict[str, str]:
    """File name of each topic: without cell and arm, unless topics of several would be one file."""
    whole = {topic: topic.strip("/").replace("/", "__") for topic in topics}
    short = {topic: "__".join(topic.strip("/").split("/")[2:]) or whole[topic] for topic in topics}
    return short if len(set(short.values())) == len(topics) else whole


def parquet_joints(path: Path) -> dict[str, np.ndarray]:
    """A joint table read back: column name -> values; for notebooks and tests."""
    table = pa.parquet.read_table(path)
    return {name: table[name].to_numpy() for name in table.column_names}
