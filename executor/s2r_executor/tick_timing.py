"""How late ticks are: a histogram since the start, filled from the core's records."""

from __future__ import annotations

import threading

import numpy as np

EDGES_S = np.array([0.0, 1e-6, 2e-6, 5e-6, 1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2])
"""Lower edges of the bins [s]; the last bin is open."""


class TickTiming:
    """Filled by the watch loop, read by the publisher."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = np.zeros(len(EDGES_S), np.int64)
        self._worst_ns = 0

    def add(self, records: np.ndarray) -> None:
        """Count a batch of the core's records."""
        late_ns = np.maximum(records["lateness_ns"].astype(np.int64), 0)
        bins = np.searchsorted(EDGES_S * 1e9, late_ns, side="right") - 1
        with self._lock:
            self._count += np.bincount(bins, minlength=len(EDGES_S))
            self._worst_ns = max(self._worst_ns, int(late_ns.max()))

    def read(self) -> tuple[np.ndarray, float]:
        """Ticks per bin, shape (bins,), and the worst lateness [s]."""
        with self._lock:
            return self._count.copy(), self._worst_ns * 1e-9
