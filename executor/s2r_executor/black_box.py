"""The last seconds before a latch: every tick's record and every event, written to a file of their own.

The ring is filled in the watch loop, which only copies; a short-lived thread writes.
"""

from __future__ import annotations

import logging
import threading
import zipfile
from pathlib import Path

import numpy as np

from s2r_executor.core import EventKind
from s2r_executor.status import known_cause

logger = logging.getLogger(__name__)

_EVENTS = 4096
_PIECE = 1024  # records


class BlackBox:
    """Keeps ``seconds`` of records; a LATCH event makes it write them, with what the rest of that batch brought."""

    def __init__(self, directory: Path, seconds: float, tick_ns: int) -> None:
        """Nothing is allocated before the first record."""
        self._directory = directory
        self._capacity = max(1, round(seconds * 1e9 / tick_ns))
        self._ring: np.ndarray | None = None
        self._count = 0
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
        if self._ring is None:
            self._ring = np.zeros(self._capacity, records.dtype)
        newest = records[-self._capacity :]
        at = (self._count + len(records) - len(newest) + np.arange(len(newest))) % self._capacity
        self._ring[at] = newest
        self._count += len(records)

    def records(self) -> np.ndarray:
        """What the ring holds, oldest first."""
        if self._ring is None:
            return np.empty(0)
        if self._count <= self._capacity:
            return self._ring[: self._count].copy()
        return np.roll(self._ring, -(self._count % self._capacity))

    def _write(self, tick: int, cause: int) -> None:
        path = self._directory / f"blackbox-{tick}-{known_cause(cause).name}.npz"
        content = self.records(), self._events
        writer = threading.Thread(target=_save, args=(path, *content), name="s2r-black-box", daemon=True)
        self._writers.append(writer)
        writer.start()

    def close(self) -> None:
        """Wait for files under way."""
        for writer in self._writers:
            writer.join()


def _save(path: Path, records: np.ndarray, events: np.ndarray) -> None:
    try:
        with zipfile.ZipFile(path, "w") as archive:
            _put(archive, "records", records)
            _put(archive, "events", events)
    except OSError as error:
        logger.error("black box %s could not be written: %s", path, error)
        return
    logger.warning("latched: the last %d ticks are in %s", len(records), path)


def _put(archive: zipfile.ZipFile, name: str, array: np.ndarray) -> None:
    """As ``numpy.savez`` does, but in small pieces: that one makes a second copy of everything."""
    header = {
        "descr": np.lib.format.dtype_to_descr(array.dtype),
        "fortran_order": False,
        "shape": array.shape,
    }
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        np.lib.format.write_array_header_2_0(file, header)
        for first in range(0, len(array), _PIECE):
            file.write(array[first : first + _PIECE].tobytes())
