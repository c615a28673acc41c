"""The one thing the camera process shares with physics: the newest joint positions, without a lock.

Physics writes after every step and never waits; the camera reads whenever it likes and repeats a read that was
overtaken.
"""

from __future__ import annotations

import multiprocessing
import time
from multiprocessing.context import SpawnContext
from typing import Any

import numpy as np

from s2r_sim.plant import Plant

_PATIENCE_S = 1.0


class Snapshot:
    """A sequence-locked array. One writer; any number of readers; travels to a spawned process."""

    def __init__(self, size: int) -> None:
        """Room for ``size`` joint positions."""
        context: SpawnContext = multiprocessing.get_context("spawn")
        self._shared: Any = context.RawArray("d", size + 1)

    def __call__(self, plant: Plant) -> None:
        """Publish the plant's positions (an observer of the plant)."""
        self.write(plant.physics.data.qpos)

    def write(self, qpos: np.ndarray) -> None:
        """Publish; the counter is odd while the values change."""
        array = self._view()
        array[0] += 1
        array[1:] = qpos
        array[0] += 1

    def read(self) -> np.ndarray:
        """The newest positions, all of the same instant.

        Raises:
            TimeoutError: The writer died in the middle of a write.
        """
        array = self._view()
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline:
            before = array[0]
            values = array[1:].copy()
            if before == array[0] and before % 2 == 0:
                return values
            time.sleep(0)
        raise TimeoutError("the positions kept changing while they were read; did the stand-in end?")

    def _view(self) -> np.ndarray:
        if not hasattr(self, "_array"):
            self._array = np.frombuffer(self._shared)
        return self._array

    def __getstate__(self) -> dict[str, Any]:
        return {"_shared": self._shared}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
