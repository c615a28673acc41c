"""What stands still beside a moving part, remembered from the views that told its joint.

A pixel that shows it does not show the part. Without this, an open lid whose edge alone is in sight is taken for a shut
one: the deck under it looks as a shut lid would.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.view import thinning

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

BESIDE_M = 0.015  # what is no nearer to the part's points is surely not the part
AROUND_M = 0.05  # so far around where the part can be, what stands still is kept in mind
SWEEP = 15


class StillSurface:
    """Points that do not move, as a depth image of any camera."""

    def __init__(self, points: Array) -> None:
        """Args: base frame [m], shape (n, 3), as dense as the pixels of a view, thinned if wide; may be none."""
        self._points = points
        self._latest: tuple[DepthFrame, Array] | None = None

    @classmethod
    def beside(cls, estimate: JointEstimate, part: Array, value_range: tuple[float, float]) -> StillSurface:
        """What the views of an estimate show around the part and is not the part.

        Args:
            estimate: With both views.
            part: Points of the part at joint value 0, base frame [m], shape (n, 3).
            value_range: Joint values between which the part can be [rad or m].
        """
        box = _swept(part, estimate.motion, value_range)
        views = (estimate.view_before, estimate.parts.before), (estimate.view_after, estimate.parts.after)
        return cls(np.concatenate([_beside(view.points, mask, box) for view, mask in views]))

    def depth_in(self, frame: DepthFrame) -> Array:
        """Depth [m] in a frame's pixels, (h, w), 0 where nothing is known; kept while the camera stays."""
        if self._latest is not None and _same_camera(self._latest[0], frame):
            return self._latest[1]
        step = thinning(frame)
        rows, columns = ((np.arange(n) + step // 2) // step for n in frame.depth_m.shape)
        h, w = int(rows[-1]) + 1, int(columns[-1]) + 1
        depth = np.zeros(
            (h, w)
        )  # as coarse as the points are dense, else most of a wide frame would know nothing
        q = (self._points - frame.X_base_camera[:3, 3]) @ frame.X_base_camera[:3, :3]
        q = q[q[:, 2] > 0.05]
        q = q[np.argsort(-q[:, 2])]  # of several in one pixel the nearest is seen
        u = np.rint((frame.K[0, 0] * q[:, 0] / q[:, 2] + frame.K[0, 2]) / step).astype(int)
        v = np.rint((frame.K[1, 1] * q[:, 1] / q[:, 2] + frame.K[1, 2]) / step).astype(int)
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        depth[v[inside], u[inside]] = q[inside, 2]
        depth = depth[np.ix_(rows, columns)]
        self._latest = frame, depth
        return depth


def carried(p: Array, motion: JointMotion, value: float) -> Array:
    """Points (n, 3) of joint value 0 at another one."""
    X = replace(motion, delta=value).transform()
    return p @ X[:3, :3].T + X[:3, 3]


def _swept(p: Array, motion: JointMotion, value_range: tuple[float, float]) -> tuple[Array, Array]:
    """Corners of the box, each (3,), in which points (n, 3) can come to lie."""
    places = np.concatenate(
        [carried(p, motion, value) for value in np.linspace(*value_range, SWEEP).tolist()]
    )
    return places.min(axis=0) - AROUND_M, places.max(axis=0) + AROUND_M


def _beside(points: Array, part: Mask, box: tuple[Array, Array]) -> Array:
    """The points (m, 3) of a view in a box that are not the part's and not so near to it that they could be."""
    rest = points[~part & ((points > box[0]) & (points < box[1])).all(axis=1)]
    if not part.any():
        return rest
    distance, _ = cKDTree(points[part]).query(rest, distance_upper_bound=BESIDE_M)
    return rest[~np.isfinite(distance)]


def _same_camera(a: DepthFrame, b: DepthFrame) -> bool:
    return (
        a.depth_m.shape == b.depth_m.shape
        and np.array_equal(a.K, b.K)
        and np.array_equal(a.X_base_camera, b.X_base_camera)
    )
