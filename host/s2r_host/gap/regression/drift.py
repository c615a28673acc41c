"""Friction that changes between sessions, as nuisance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.gap.regression.rows import Block

DRIFT_SHARE = 0.15


@dataclass
class Drift:
    """Friction of a held-out session that was not among the fitted ones, as nuisance: dry and viscous change.

    Attributes:
        block: Rows it belongs to.
        columns: Whitened direction of motion (and speed, where there is viscous friction), shape (rows, k).
        raw: Direction of motion in effort units, shape (rows,).
        level: Friction the fitted sessions show: dry [N·m or N], viscous [N·m·s/rad or N·s/m], shape (k,).
    """

    block: Block
    columns: np.ndarray
    raw: np.ndarray
    level: np.ndarray

    def estimate(
        self, left: np.ndarray, noise: float, found: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Changes the whitened leftover of this block asks for, their covariance, levels and columns.

        Args:
            left: Whitened leftover, shape (rows of the problem,).
            noise: Variance of a whitened row.
            found: Whitened friction that effects of the catalogue add, shape (rows of the problem,): it drifts too.

        Returns:
            (k,), (k, k), (k,) and (rows, k); the level of what was found is one.
        """
        columns, level = self.columns, self.level
        if found is not None and np.any(found[self.block.rows]):
            columns = np.concatenate([columns, found[self.block.rows][:, None]], axis=1)
            level = np.append(level, 1.0)
        power, pull = columns.T @ columns / noise, columns.T @ left[self.block.rows] / noise

        def solved(width: float) -> tuple[np.ndarray, np.ndarray]:
            covariance = np.linalg.inv(power + np.diag((width * level) ** -2.0))
            return covariance @ pull, covariance

        change, covariance = solved(DRIFT_SHARE)
        for _ in range(2):  # a prior as wide as what it is asked to allow
            change, covariance = solved(max(DRIFT_SHARE, 2.0 * abs(float(change[0])) / float(level[0])))
        return change, covariance, level, columns
