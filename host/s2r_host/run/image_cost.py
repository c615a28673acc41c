"""How badly a part at a joint value explains a depth image, in the image itself.

Matching points needs faces that the camera saw before. A lid that stands edge-on or shows its other face has none,
but where it cannot be is as telling: pixels the camera sees through, and pixels in front of what stays, or where
nothing is known to stay, that nothing else explains. All of it comes from one picture of the part, its nearest surface
per cell.
"""

from __future__ import annotations

import warnings

import numpy as np

from s2r_host.perception.frames import pixel_rays
from s2r_host.perception.view import DepthView

CELL_PX = 2
TRUNCATION_M = 0.012
CLAIM_M = 0.008  # what is seen that near to where the part might be, with nothing known behind, is the part
TABLE_M = 0.010
HIDDEN_M = 0.010  # a part this far behind what stays is not seen


class ImageCost:
    """Cost of joint values for one view.

    Args:
        view: The new look.
        p_still: What stays where it is [m], base frame, (m, 3); where it is unknown, nothing is held against a value.
    """

    def __init__(self, view: DepthView, p_still: np.ndarray) -> None:
        self._view = view
        h, w = view.shape
        self._shape = -(-h // CELL_PX), -(-w // CELL_PX)
        self._z_seen = self._reduced(view.depth)
        self._z_still = self.nearest(p_still)
        self._above_table = self._heights() > TABLE_M

    def nearest(self, p: np.ndarray) -> np.ndarray:
        """Depth of the nearest of some points (n, 3) in every cell [m], infinite where there is none, (cells,)."""
        z, cell = self._cells(p)
        out = np.full(self._shape[0] * self._shape[1], np.inf)
        ahead = cell >= 0
        np.minimum.at(out, cell[ahead], z[ahead])
        return out

    def visible(self, p: np.ndarray, slack_m: float) -> np.ndarray:
        """Which points are the nearest of their cell, within some slack; shape (n,), bool."""
        z, cell = self._cells(p)
        nearest = np.minimum(self.nearest(p), self._z_still + HIDDEN_M)
        return (cell >= 0) & (z < nearest[np.maximum(cell, 0)] + slack_m)

    def cells(self, p: np.ndarray) -> int:
        """In how many cells points (n, 3) should be seen."""
        z = self.nearest(p)
        return int((np.isfinite(z) & (self._z_still > z - HIDDEN_M)).sum())

    def seen_as_told(self, p: np.ndarray) -> float:
        """Share of the cells in which points (n, 3) should be seen where something is seen that near; 0 if none."""
        z = self.nearest(p)
        covered = np.isfinite(z) & (self._z_still > z - HIDDEN_M) & (self._z_seen > 0.0)
        if not covered.any():
            return 0.0
        return float((np.abs(self._z_seen[covered] - z[covered]) < TRUNCATION_M).mean())

    def of(self, shapes: list[np.ndarray], strips: int = 1) -> np.ndarray:
        """Cost of each set of points (n, 3), the part at one joint value each.

        Args:
            shapes: Points of the part [m], base frame.
            strips: Vertical strips of the image that are judged apart, for the spread.

        Returns:
            Mean truncated cost per cell that any of the shapes covers, shape (strips, len(shapes)); rows of strips
            without such cells are NaN.
        """
        pictures = [self.nearest(p) for p in shapes]
        swept = np.zeros(len(self._z_seen), bool)
        claimed = np.zeros(len(self._z_seen), bool)
        for picture in pictures:
            swept |= np.isfinite(picture)
            claimed |= np.abs(picture - self._z_seen) < CLAIM_M
        claimed &= self._above_table & ~np.isfinite(self._z_still)
        column = np.arange(len(swept)) % self._shape[1]
        edges = np.quantile(column[swept], np.linspace(0.0, 1.0, strips + 1)[1:-1]) if swept.any() else []
        strip = np.searchsorted(edges, column, side="right")
        total = np.bincount(strip[swept], minlength=strips).astype(float)
        cost = np.column_stack(
            [np.bincount(strip[swept], self._per_cell(z, claimed)[swept], minlength=strips) for z in pictures]
        )
        return np.where(total[:, None] > 0, cost / np.maximum(total, 1.0)[:, None], np.nan)

    def _per_cell(self, z: np.ndarray, claimed: np.ndarray) -> np.ndarray:
        """Cost per cell of a picture of the part; ``claimed`` cells show what only the part can be."""
        seen, known = self._z_seen > 0.0, np.isfinite(self._z_still)
        covered = np.isfinite(z) & (self._z_still > z - HIDDEN_M)
        gap = np.where(covered, self._z_seen, 0.0) - np.where(covered, z, 0.0)
        cost = np.minimum(np.abs(gap), TRUNCATION_M) / TRUNCATION_M
        cost[~seen | (gap < -TRUNCATION_M)] = 0.5  # no return, or something else in front: says nothing
        in_front = known & seen & (self._z_seen < np.where(known, self._z_still, 0.0) - TRUNCATION_M)
        return np.where(covered, cost, (in_front | claimed).astype(float))

    def _heights(self) -> np.ndarray:
        """Height of what is seen in every cell above the base frame's level plane [m], (cells,)."""
        X, K = np.linalg.inv(self._view.X_camera_base), self._view.K
        rows, columns = np.divmod(np.arange(len(self._z_seen)), self._shape[1])
        u, v = CELL_PX * (columns + 0.5) - 0.5, CELL_PX * (rows + 0.5) - 0.5
        return self._z_seen * (pixel_rays(K, u, v) @ X[2, :3]) + X[2, 3]

    def _cells(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(depth [m], cell or -1) of points (n, 3)."""
        X, K = self._view.X_camera_base, self._view.K
        p_C = p @ X[:3, :3].T + X[:3, 3]
        z = p_C[:, 2]
        ahead = z > 0.05
        safe = np.where(ahead, z, 1.0)
        u = np.floor((K[0, 0] * p_C[:, 0] / safe + K[0, 2] + 0.5) / CELL_PX).astype(int)
        v = np.floor((K[1, 1] * p_C[:, 1] / safe + K[1, 2] + 0.5) / CELL_PX).astype(int)
        inside = ahead & (u >= 0) & (u < self._shape[1]) & (v >= 0) & (v < self._shape[0])
        return z, np.where(inside, v * self._shape[1] + u, -1)

    def _reduced(self, depth: np.ndarray) -> np.ndarray:
        """Median of the returns in every cell [m], 0 without any, (cells,)."""
        h, w = depth.shape
        rows, columns = self._shape
        padded = np.zeros((rows * CELL_PX, columns * CELL_PX))
        padded[:h, :w] = depth
        cells = (
            padded.reshape(rows, CELL_PX, columns, CELL_PX).transpose(0, 2, 1, 3).reshape(rows * columns, -1)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # cells without a return
            return np.nan_to_num(np.nanmedian(np.where(cells > 0, cells, np.nan), axis=1), nan=0.0)
