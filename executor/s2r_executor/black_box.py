"""The last seconds before a latch: every tick's record and every event, written to a file of their own.

The watch loop only compresses and keeps; a short-lived thread writes. Pieces never change once they are kept, so that
writing needs no second copy of half a minute of records.
"""

from __future__ import annotations

import logging
import threading
import zipfile
import zlib
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_executor.core import EventKind
from s2r_executor.status import known_cause

logger = logging.getLogger(__name__)

_EVENTS = 4096
_PIECE = 256  # records: a millisecond of compressing
_LEVEL = 1


@dataclass(frozen=True)
class _Piece:
    """Consecutive records, compressed."""

    count: int
    data: bytes


class BlackBox:
    """Keeps ``seconds`` of records; a LATCH event makes it write them, with what the rest of that batch brought."""

    def __init__(self, directory: Path, seconds: float, tick_ns: int) -> None:
        """Nothing is allocated before the first record."""
        self._directory = directory
        self._capacity = max(1, round(seconds * 1e9 / tick_ns))
        self._pieces: deque[_Piece] = deque()
        self._kept = 0  # records in all pieces
        self._dtype = np.dtype(np.float64)  # until there is a record
        self._open: list[np.ndarray] = []  # not yet a piece
        self._opened = 0  # records in those
        self._events: np.ndarray | None = None
        self._writers: list[threading.Thread] = []

    def add(self, records: np.ndarray, events: np.ndarray) -> None:
        """Keep a batch; called by one thread."""
        if len(records):
            self._keep(records)
        if not len(events):
            return
        self._events = events if self._events is None else np.concatenate([self._events, events])[-_EVENTS:]
        for latch in events[events["kind"] == EventKind.LATCH]:
            self._write(int(latch["tick"]), int(latch["cause"]))

    def _keep(self, records: np.ndarray) -> None:
        self._dtype = records.dtype
        self._open.append(records)
        self._opened += len(records)
        if self._opened < _PIECE:
            return
        waiting = np.concatenate(self._open)
        self._open, self._opened = [], 0
        for first in range(0, len(waiting), _PIECE):
            piece = waiting[first : first + _PIECE]
            self._pieces.append(_Piece(len(piece), zlib.compress(piece.tobytes(), _LEVEL)))
        self._kept += len(waiting)
        while self._kept - self._pieces[0].count >= self._capacity:
            self._kept -= self._pieces.popleft().count

    def _write(self, tick: int, cause: int) -> None:
        path = self._directory / f"blackbox-{tick}-{known_cause(cause).name}.npz"
        newest = np.concatenate([np.empty(0, self._dtype), *self._open])
        content = list(self._pieces), newest, self._capacity, self._events
        writer = threading.Thread(target=_save, args=(path, *content), name="s2r-black-box", daemon=True)
        self._writers.append(writer)
        writer.start()

    def close(self) -> None:
        """Wait for files under way."""
        for writer in self._writers:
            writer.join()


def _save(path: Path, pieces: list[_Piece], newest: np.ndarray, capacity: int, events: np.ndarray) -> None:
    count = sum(piece.count for piece in pieces) + len(newest)
    surplus = max(0, count - capacity)
    try:
        with zipfile.ZipFile(path, "w") as archive:
            _put(archive, "records", newest.dtype, count - surplus, _bytes_of(pieces, newest, surplus))
            _put(archive, "events", events.dtype, len(events), iter([events.tobytes()]))
    except OSError as error:
        logger.error("black box %s could not be written: %s", path, error)
        return
    logger.warning("latched: the last %d ticks are in %s", count - surplus, path)


def _bytes_of(pieces: list[_Piece], newest: np.ndarray, surplus: int) -> Iterator[bytes]:
    """Of all records but the first ``surplus``, oldest first."""
    for piece in pieces:
        skipped = min(surplus, piece.count)
        surplus -= skipped
        yield zlib.decompress(piece.data)[skipped * newest.dtype.itemsize :]
    yield newest[surplus:].tobytes()


def _put(archive: zipfile.ZipFile, name: str, dtype: np.dtype, count: int, parts: Iterator[bytes]) -> None:
    """As ``numpy.savez`` does, but from parts: that one makes a second copy of everything."""
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (count,)}
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        np.lib.format.write_array_header_2_0(file, header)
        for part in parts:
            file.write(part)
