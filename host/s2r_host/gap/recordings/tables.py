"""Tables of recordings: CSV, Parquet or MCAP to one array per column, as the file has them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.recordings.recording import belongs


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Columns of a file by name, each of shape (rows,), NaN where a cell is empty.

    What is no column of the contract may hold anything; it is all NaN.

    Raises:
        GapRecordingError: The file is no table of numbers.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return _read_csv(path)
    if suffix in (".parquet", ".pq"):
        return _read_parquet(path)
    if suffix == ".mcap":
        from s2r_host.gap.recordings.mcap import read_mcap

        return read_mcap(path)
    raise GapRecordingError(f"{path.name}: format '{suffix}' is not read; give CSV, Parquet or MCAP")


def _read_csv(path: Path) -> dict[str, np.ndarray]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = csv.reader(stream)
            header = [name.strip() for name in next(rows, [])]
            body = [row for row in rows if row]
        whole = _ends_with_its_line(path)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise GapRecordingError(f"{path.name}: not a readable CSV ({error})") from error
    if not any(header):
        raise GapRecordingError(
            f"{path.name}: the file is empty; its first line has to name the columns (t, q.<joint>, …)"
        )
    if "t" not in header:
        raise GapRecordingError(f"{path.name}: no column 't'; columns are {', '.join(header[:12])}")
    if len(set(header)) != len(header):
        twice = sorted({name for name in header if header.count(name) > 1})
        raise GapRecordingError(f"{path.name}: column '{twice[0]}' appears twice")
    values = np.full((len(body), len(header)), np.nan)
    read = [column for column, name in enumerate(header) if belongs(name)]
    for line, row in enumerate(body):
        if len(row) != len(header):
            if line == len(body) - 1:  # a truncated last line is what a power cut leaves behind
                values = values[:-1]
                break
            raise GapRecordingError(
                f"{path.name}: line {line + 2} has {len(row)} cells, the header has {len(header)}"
            )
        for column in read:
            cell = row[column]
            if cell.strip() == "":
                continue
            try:
                values[line, column] = float(cell)
            except ValueError as error:
                if line == len(body) - 1 and column == len(header) - 1 and not whole:
                    break  # cut off within its last number
                raise GapRecordingError(
                    f"{path.name}: line {line + 2}, column '{header[column]}': '{cell[:20]}' is not a number"
                ) from error
    return {name: values[:, i] for i, name in enumerate(header)}


def _ends_with_its_line(path: Path) -> bool:
    with path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - 1, 0))
        return stream.read() in (b"\n", b"\r")


def _read_parquet(path: Path) -> dict[str, np.ndarray]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(path).read()
        if len(set(table.column_names)) != len(table.column_names):
            twice = sorted({name for name in table.column_names if table.column_names.count(name) > 1})
            raise GapRecordingError(f"{path.name}: column '{twice[0]}' appears twice")
        return {
            name: np.asarray(table.column(name).to_numpy(zero_copy_only=False), dtype=float)
            if belongs(name)
            else np.full(len(table), np.nan)
            for name in table.column_names
        }
    except (OSError, ValueError, TypeError, pa.ArrowException) as error:
        raise GapRecordingError(f"{path.name}: not a readable Parquet table ({error})") from error
