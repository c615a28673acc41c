"""Friction that changes between sessions, as nuisance."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from s2r_host.gap.regression.rows import Block

DRIFT_SHARE = 0.15


@dataclass
class Drift:
    """Friction of a held-out session that was not among the fitted ones, as nuisance: dry and viscous change.

    Attributes:
        blocks: Rows of one joint in every recording of the session; ``rows`` their numbers, shape (rows,).
        columns: Whitened direction of motion (and speed, where there is viscous friction), shape (rows, k).
        level: Friction the fitted sessions show: dry [N·m or N], viscous [N·m·s/rad or N·s/m], shape (k,).
    """

    blocks: list[Block]
    columns: np.ndarray
    level: np.ndarray
    rows: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.rows = np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in self.blocks])

    def estimate(
        self, left: np.ndarray, noise: float, found: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Changes the whitened leftover of these rows asks for, their covariance, levels and columns.

        Args:
            left: Whitened leftover, shape (rows of the problem,).
            noise: Variance of a whitened row.
            found: Whitened friction that effects of the catalogue add, shape (rows of the problem,): it drifts too.

        Returns:
            (k,), (k, k), (k,) and (rows, k); the level of what was found is one.
        """
        columns, level = self.columns, self.level
        if found is not None and np.any(found[self.rows]):
            columns = np.concatenate([columns, found[self.rows][:, None]], axis=1)
            level = np.append(level, 1.0)
        power, pull = columns.T @ columns / noise, columns.T @ left[self.rows] / noise

        def solved(width: float) -> tuple[np.ndarray, np.ndarray]:
            covariance = np.linalg.inv(power + np.diag((width * level) ** -2.0))
            return covariance @ pull, covariance

        change, covariance = solved(DRIFT_SHARE)
        for _ in range(2):  # a prior as wide as what it is asked to allow
            change, covariance = solved(max(DRIFT_SHARE, 2.0 * abs(float(change[0])) / float(level[0])))
        return change, covariance, level, columns
