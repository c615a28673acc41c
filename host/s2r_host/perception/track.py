"""Live state: the joint value of a known object from one depth frame after another.

The part's points are moved by the joint and compared with the frame where they project: one unknown, a few
hundred residuals, no neighbour search and no plane fit, so that a frame costs milliseconds. What stands in
front of the part (the arm) is ignored; what lies behind it speaks against the value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import BadViewError
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.intervals import Z90
from s2r_host.perception.motion import JointMotion, rotation
from s2r_host.perception.refine import CORRELATED_POINTS
from s2r_host.perception.view import noise_sigma

Array = NDArray[np.floating]

MOST_POINTS = 500
SEARCH_POINTS = 150
SEARCH_STEPS = 81
GATES_M = (0.02, 0.012, 0.008, 0.006, 0.006)
LEAST_SEEN = 0.12  # share of the part's points on a matching surface; below it the part counts as lost
FACING = 0.15  # cosine: flatter views of a surface say nothing
FLOOR_SLIDE_M, FLOOR_TURN_RAD = 0.0007, np.radians(0.4)


@dataclass(frozen=True)
class TrackedState:
    """The joint in one frame.

    Attributes:
        value: Joint value [rad or m], None when lost.
        interval90: Low and high end, None when lost.
        seen: Share of the part's points found on a matching surface.
        residual_m: Robust spread of their distances [m].
    """

    value: float | None
    interval90: tuple[float, float] | None
    seen: float
    residual_m: float


class JointTracker:
    """Follows one joint. The joint value is that of the estimate: 0 in its first view."""

    def __init__(
        self,
        points: Array,
        normals: Array,
        motion: JointMotion,
        value_range: tuple[float, float],
        start: float = 0.0,
    ) -> None:
        """Track a part given by its surface at joint value 0.

        Args:
            points: Base frame [m], shape (n, 3).
            normals: Unit, outwards, shape (n, 3).
            motion: Axis; its delta is not used.
            value_range: Where to look for the part when it is lost [rad or m].
            start: Value in the last frame seen.

        Raises:
            BadViewError: Too few points.
        """
        if len(points) < 50:
            raise BadViewError(f"the part has {len(points)} points with a surface, tracking needs 50 or more")
        self._p, self._n = points, normals
        self._motion = motion
        self._range = value_range
        self._last: float | None = start

    @classmethod
    def of(
        cls, estimate: JointEstimate, value_range: tuple[float, float] | None = None, seed: int = 0
    ) -> JointTracker:
        """Track the part of an estimate, seen in either of its views."""
        X = estimate.motion.transform()
        a, b = estimate.view_before, estimate.view_after
        of_a, of_b = estimate.parts.before & a.normal_ok, estimate.parts.after & b.normal_ok
        p = np.concatenate([a.points[of_a], (b.points[of_b] - X[:3, 3]) @ X[:3, :3]])
        n = np.concatenate([a.normals[of_a], b.normals[of_b] @ X[:3, :3]])
        chosen = np.random.default_rng(seed).permutation(len(p))[:MOST_POINTS]
        reach = 1.5 * estimate.delta
        return cls(
            p[chosen],
            n[chosen],
            estimate.motion,
            value_range or (-reach, estimate.delta + reach),
            estimate.delta,
        )

    def update(self, frame: DepthFrame, ignore: NDArray[np.bool_] | None = None) -> TrackedState:
        """The joint value in a frame; starts from the last one, searches the range when lost.

        Args:
            frame: Depth of any camera whose pose is known.
            ignore: Pixels (h, w) to forget, e.g. the arm.

        Raises:
            BadViewError: ``ignore`` is not of the frame's size.
        """
        if ignore is not None and ignore.shape != frame.depth_m.shape:
            raise BadViewError(
                f"ignore has shape {ignore.shape}, the frame's depth {frame.depth_m.shape}; they must agree"
            )
        camera = _Camera(frame, ignore)
        state = self._refined(camera, self._last) if self._last is not None else None
        if state is None or state.value is None:
            state = self._refined(camera, self._searched(camera))
        self._last = state.value
        return state

    def _refined(self, camera: _Camera, value: float) -> TrackedState:
        seen, spread, information = 0.0, 0.01, 0.0
        for gate in GATES_M:
            e, slope, sigma, facing = self._residuals(camera, value, slice(None))
            use = np.isfinite(e) & (np.abs(e) < gate)
            if use.sum() < 20:
                return TrackedState(None, None, float(use.sum() / max(facing, 1)), 0.01)
            weight = 1.0 / (1.0 + (e[use] / (2 * sigma[use])) ** 2)
            information = float((weight * slope[use] ** 2).sum())
            if information < 1e-9:
                return TrackedState(None, None, 0.0, 0.01)
            value += float((weight * slope[use] * e[use]).sum()) / information
            spread = 1.4826 * float(np.median(np.abs(e[use])))
            seen = float(use.sum() / max(facing, 1))
        low, high = self._range
        if seen < LEAST_SEEN or not low - 0.3 * (high - low) <= value <= high + 0.3 * (high - low):
            return TrackedState(None, None, seen, spread)
        floor = FLOOR_TURN_RAD if self._motion.joint_type == "revolute" else FLOOR_SLIDE_M
        half = Z90 * float(np.sqrt(max(spread, 0.0005) ** 2 * CORRELATED_POINTS / information + floor**2))
        return TrackedState(value, (value - half, value + half), seen, spread)

    def _searched(self, camera: _Camera) -> float:
        """The value of the range whose prediction the frame contradicts least."""
        step = max(1, len(self._p) // SEARCH_POINTS)
        values = np.linspace(*self._range, SEARCH_STEPS)
        costs = []
        for value in values:
            e, _, sigma, _ = self._residuals(camera, float(value), slice(None, None, step))
            cost = np.minimum((e / (3 * sigma)) ** 2, 1.5)
            costs.append(float(np.where(np.isfinite(e), cost, 1.0).mean()))
        return float(values[int(np.argmin(costs))])

    def _residuals(self, camera: _Camera, value: float, part: slice) -> tuple[Array, Array, Array, int]:
        """Per point: distance of the measured surface along the normal [m], its change per joint value, noise [m].

        NaN where there is no return, something stands in front, or the surface is seen at a grazing angle. Last, how
        many points face the camera inside the image.
        """
        p, n, way = self._moved(value, part)
        q, m = p @ camera.R.T + camera.t, n @ camera.R.T
        z = np.maximum(q[:, 2], 1e-3)
        u = np.rint(camera.K[0, 0] * q[:, 0] / z + camera.K[0, 2]).astype(int)
        v = np.rint(camera.K[1, 1] * q[:, 1] / z + camera.K[1, 2]).astype(int)
        h, w = camera.depth.shape
        ray = q / z[:, None]
        cosine = np.einsum("ni,ni->n", m, ray) / np.linalg.norm(ray, axis=1)
        good = (q[:, 2] > 0.05) & (u >= 0) & (u < w) & (v >= 0) & (v < h) & (cosine < -FACING)
        measured = camera.depth[np.where(good, v, 0), np.where(good, u, 0)]
        ahead = measured - z
        sigma = noise_sigma(z)
        e = np.einsum("ni,ni->n", m, ray) * ahead
        e[~good | (measured <= 0) | (ahead < -GATES_M[0])] = np.nan
        return e, np.einsum("ni,ni->n", n, way), sigma, int(good.sum())

    def _moved(self, value: float, part: slice) -> tuple[Array, Array, Array]:
        """Points, normals and velocity per joint value at a joint value."""
        motion, p, n = self._motion, self._p[part], self._n[part]
        if motion.joint_type == "prismatic":
            return p + value * motion.direction, n, np.broadcast_to(motion.direction, p.shape)
        R = rotation(motion.direction, value)
        moved = (p - motion.origin) @ R.T
        return moved + motion.origin, n @ R.T, np.cross(motion.direction, moved)


class _Camera:
    """A frame made ready for projection."""

    def __init__(self, frame: DepthFrame, ignore: NDArray[np.bool_] | None) -> None:
        self.depth = frame.depth_m if ignore is None else np.where(ignore, 0.0, frame.depth_m)
        self.K = frame.K
        R = frame.X_base_camera[:3, :3]
        self.R = R.T
        self.t = -R.T @ frame.X_base_camera[:3, 3]
