"""How many contacts a model has at many positions, without physics."""

from __future__ import annotations

import mujoco
import mujoco.batch
import numpy as np

_AT_A_TIME = 256


class ContactCount:
    """Counts contacts by collision detection alone. Not for several Python threads."""

    def __init__(self, model: mujoco.MjModel, threads: int) -> None:
        """Args: the model; threads that share the positions."""
        self._batch = mujoco.batch.Batch(model, nsim=_AT_A_TIME, nthread=threads)
        # Bound before the first call: an output that is bound after it would be empty.
        self._qpos, self._ncon = self._batch.bind("qpos"), self._batch.bind("ncon")
        self._ids = np.arange(_AT_A_TIME, dtype=np.int32)

    def at(self, qpos: np.ndarray) -> np.ndarray:
        """Number of contacts, (n,), at positions (n, nq)."""
        counts = np.empty(len(qpos), dtype=int)
        for start in range(0, len(qpos), _AT_A_TIME):
            some = qpos[start : start + _AT_A_TIME]
            self._qpos[: len(some)] = some
            self._batch.forward(ids=self._ids[: len(some)], stage=int(mujoco.mjtStage.mjSTAGE_POS))
            counts[start : start + len(some)] = self._ncon[: len(some)].reshape(-1)
        return counts
