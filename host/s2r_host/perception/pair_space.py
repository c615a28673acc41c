"""Points of space and the seen points beside them, as the pair network's occupancy reads them.

The part is looked at in the pose of the first view: what the second view shows of it is carried back by the motion.
What neither view shows (the back of a lid, the far side of a lever) is left to the features of the points around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.motion import JointMotion
from s2r_host.perception.pair_cloud import PairCloud

Array = NDArray[np.floating]
Index = NDArray[np.int64]

NEAREST = 8
FAR_CM = 4.0
BESIDES = (
    9  # way to the neighbour [cm], its normal, the way along it [cm], its view, whether it is the part's
)


@dataclass(frozen=True, eq=False)
class Beside:
    """The seen points beside queries.

    Attributes:
        index: Into the points of both views, flattened, shape (Q, `NEAREST`).
        geometry: Way from the query in the frame of the views and its length along the normal [cm], normal, view (0 or
            1), belongs to the part (0 to 1), in the order of `BESIDES`, shape (Q, `NEAREST`, `BESIDES`).
    """

    index: Index
    geometry: NDArray[np.float32]

    def turned(self, R: Array, size: float = 1.0) -> Beside:
        """The same in a frame turned by R (3, 3), everything grown by ``size``."""
        g = self.geometry.copy()
        g[..., :3] = size * g[..., :3] @ R.T
        g[..., 3:6] = g[..., 3:6] @ R.T
        g[..., 6] *= size
        return Beside(self.index, g)


def beside(query: Array, cloud: PairCloud, part: Array, motion: JointMotion) -> Beside:
    """Look for the points beside queries.

    Args:
        query: Points of space [m], the part as in the first view, shape (Q, 3).
        cloud: Both views.
        part: How far points of the views are believed to belong to the part, 0 to 1, shape (2, P).
        motion: Of the part from the first view to the second.
    """
    X = np.linalg.inv(motion.transform())
    p = np.concatenate([cloud.points[0], cloud.points[1] @ X[:3, :3].T + X[:3, 3]])
    n = np.concatenate([cloud.normals[0], cloud.normals[1] @ X[:3, :3].T])
    count = len(cloud.points[0])
    mine = part.reshape(-1)
    # What stayed is the same in both views and is taken from the first.
    kept = np.flatnonzero((np.arange(2 * count) < count) | (mine > 0.5))
    _, near = cKDTree(p[kept]).query(query, k=NEAREST)
    index = kept[np.minimum(np.asarray(near), len(kept) - 1)]
    way = 100 * (p[index] - query[:, None])
    along = np.einsum("qki,qki->qk", way, n[index])[..., None]
    # Farther away it is the same how far; large numbers only drown the small ones.
    way *= np.minimum(1.0, FAR_CM / np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1e-9))
    columns = (
        way,
        n[index],
        np.clip(along, -FAR_CM, FAR_CM),
        (index >= count)[..., None],
        mine[index][..., None],
    )
    return Beside(index, np.concatenate(columns, axis=2).astype(np.float32))
