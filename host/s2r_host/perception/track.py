"""Live state: the joint value of a known object from one depth frame after another.

The part's points are moved by the joint and compared with the frame where they project: one or two unknowns, a few
hundred residuals, no neighbour search and no plane fit, so that a frame costs milliseconds. What stands in
front of the part (the arm) is ignored. What lies behind it speaks against the value: the camera cannot look through
the part, whichever of its faces it sees. A fit that the frame contradicts is not believed; the part is then looked for
in the whole range, and it is lost where the frame contradicts every value of it or two far apart fit alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.errors import BadViewError
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.intervals import CHI90_2, Z90, Intervals
from s2r_host.perception.motion import JointMotion, rotation
from s2r_host.perception.track_fit import PLATE_M, Sighting, fit_step
from s2r_host.perception.track_still import StillSurface, carried
from s2r_host.perception.view import noise_sigma

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

LEAST_POINTS, MOST_POINTS = 50, 500
SEARCH_POINTS = 150
SEARCH_STEP_M = 0.012  # of the part's farthest point
MOST_SEARCHED, REFINED_MINIMA = 240, 3
GATES_M = (0.02, 0.012, 0.008, 0.006, 0.006)
LEAST_SEEN = 0.12  # share of the part's points on a matching surface; below it the part counts as lost
MOST_THROUGH = 0.3  # of the points that the frame speaks of, the share seen through; above it a fit is no fit
DOUBTED_THROUGH, DOUBTED_SEEN = 0.12, 0.4  # a fit worse than this is compared with those of the whole range
# Asked of a fit that does not start from the last value: half of the part may be hidden, little of it be denied.
ELSEWHERE_SEEN, ELSEWHERE_THROUGH, ELSEWHERE_SPREAD_M = 0.35, 0.1, 0.0025
CLEARLY = 0.15  # by how much of the points the better one of two fits is better
FACING = 0.15  # cosine: flatter views of a surface say nothing
FLOOR_SLIDE_M, FLOOR_TURN_RAD = 0.0007, np.radians(0.4)
STILL_SIGMAS = 4.0  # of the depth noise: the still surface was seen with noise, too
THROUGH_COST = 2.5  # of a point in the search, where one that is not seen at all costs 1
WIDE_TURN_RAD, WIDE_SLIDE_M = 2.0, 0.4  # beyond the values seen, where nobody says how far the part can go
PLATE_NORMALS, PLATE_COSINE = 0.8, 0.9


@dataclass(frozen=True)
class TrackedState:
    """The joint in one frame.

    Attributes:
        value: Joint value [rad or m], None when lost.
        interval90: Low and high end, None when lost.
        seen: Share of the part's points found on a matching surface.
        residual_m: Robust spread of their distances [m].
        through: Of the points that the frame speaks of, the share that it looked through.
    """

    value: float | None
    interval90: tuple[float, float] | None
    seen: float
    residual_m: float
    through: float = 0.0


class JointTracker:
    """Follows one joint. The joint value is that of the estimate: 0 in its first view."""

    def __init__(
        self,
        points: Array,
        normals: Array,
        motion: JointMotion,
        value_range: tuple[float, float],
        start: float = 0.0,
        known_to: Intervals | None = None,
        still: StillSurface | None = None,
    ) -> None:
        """Track a part given by its surface at joint value 0.

        Args:
            points: Base frame [m], shape (n, 3).
            normals: Unit, outwards, shape (n, 3).
            motion: Axis; its delta is not used.
            value_range: Where the part can be [rad or m].
            start: Value in the last frame seen.
            known_to: How well the axis and the motion between the two views of the part are known; None if exactly.
            still: What stands still beside the part; None where nothing is known of it.

        Raises:
            BadViewError: Too few points, or a range without values.
        """
        _require_surface(points)
        if not value_range[0] < value_range[1]:
            raise BadViewError(
                f"value_range goes from {value_range[0]:g} to {value_range[1]:g}; the first must be the lower one"
            )
        self._p, self._n = points, normals
        self._motion = motion
        self._range = value_range
        self._last: float | None = start
        self._known_to = known_to
        self._still = still or StillSurface(np.empty((0, 3)))
        main = np.linalg.eigh(normals.T @ normals)[1][:, -1]
        self._plate = float((np.abs(normals @ main) > PLATE_COSINE).mean()) > PLATE_NORMALS
        lever = np.linalg.norm(np.cross(motion.direction, points - motion.origin), axis=1)
        self._reach_m = 1.0 if motion.joint_type == "prismatic" else max(0.01, float(lever.max()))

    @classmethod
    def of(
        cls, estimate: JointEstimate, value_range: tuple[float, float] | None = None, seed: int = 0
    ) -> JointTracker:
        """Track the part of an estimate, seen in either of its views.

        Raises:
            BadViewError: Too few points in both, or a range without values.
        """
        X = estimate.motion.transform()
        a, b = estimate.view_before, estimate.view_after
        of_a, of_b = estimate.parts.before & a.normal_ok, estimate.parts.after & b.normal_ok
        p = np.concatenate([a.points[of_a], (b.points[of_b] - X[:3, 3]) @ X[:3, :3]])
        n = np.concatenate([a.normals[of_a], b.normals[of_b] @ X[:3, :3]])
        _require_surface(p)
        chosen = np.random.default_rng(seed).permutation(len(p))[:MOST_POINTS]
        low, high = sorted((0.0, estimate.delta))
        reach = max(1.5 * (high - low), WIDE_TURN_RAD if estimate.joint_type == "revolute" else WIDE_SLIDE_M)
        values = value_range or (low - reach, high + reach)
        still = StillSurface.beside(estimate, p[chosen], values)
        return cls(p[chosen], n[chosen], estimate.motion, values, estimate.delta, estimate.intervals90, still)

    def update(self, frame: DepthFrame, ignore: NDArray[np.bool_] | None = None) -> TrackedState:
        """The joint value in a frame; starts from the last one, searches the range when lost or in doubt.

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
        camera = _Camera(frame, ignore, self._still.depth_in(frame))
        near = self._refined(camera, self._last) if self._last is not None else _LOST
        if near.value is not None and near.through < DOUBTED_THROUGH and near.seen > DOUBTED_SEEN:
            state = near
        else:
            elsewhere = [self._refined(camera, value) for value in self._searched(camera)]
            state = _best(near, [fit for fit in elsewhere if _stands_alone(fit)])
        self._last = state.value
        return state

    def _refined(self, camera: _Camera, value: float) -> TrackedState:
        plate, spread, fit = PLATE_M, 0.01, None
        for gate in GATES_M:
            seen = self._seen(camera, value, slice(None))
            fit = fit_step(seen, plate, gate, spread, self._plate)
            if fit is None:
                return _LOST
            value, plate, spread = value + fit.step, fit.plate_m, fit.spread_m
        assert fit is not None
        low, high = self._range
        margin = 0.3 * (high - low)
        lost = TrackedState(None, None, fit.share, fit.spread_m, fit.through)
        if fit.share < LEAST_SEEN + fit.through or fit.through > MOST_THROUGH:
            return lost
        if not low - margin <= value <= high + margin:
            return lost
        floor = FLOOR_SLIDE_M if self._motion.joint_type == "prismatic" else FLOOR_TURN_RAD
        half = Z90 * float(np.sqrt(fit.variance + floor**2 + self._axis_variance(value, fit.lever)))
        return TrackedState(value, (value - half, value + half), fit.share, fit.spread_m, fit.through)

    def _axis_variance(self, value: float, lever: float) -> float:
        """What the estimate's own errors are worth at a joint value [rad² or m²].

        In the two views the part is where it was seen, up to the error of the motion between them; further on, an axis
        that is beside the true one carries it aside.
        """
        if self._known_to is None:
            return 0.0
        low, high = self._known_to.delta
        delta = 0.5 * (low + high)
        share = float(np.clip(value / delta, 0.0, 1.0)) if delta else 0.0
        variance = (share * 0.5 * (high - low) / Z90) ** 2
        if self._motion.joint_type == "revolute":
            beyond = max(0.0, min(0.0, delta) - value, value - max(0.0, delta))
            aside = 2 * np.sin(min(beyond, np.pi) / 2) * self._known_to.axis_offset_m / CHI90_2
            variance += (aside / max(lever, 0.005)) ** 2
        return float(variance)

    def _searched(self, camera: _Camera) -> list[float]:
        """Values of the range that the frame contradicts least, each in a valley of its own, best first."""
        step = max(1, len(self._p) // SEARCH_POINTS)
        low, high = self._range
        count = int(np.clip((high - low) * self._reach_m / SEARCH_STEP_M, 40, MOST_SEARCHED))
        values = np.linspace(low, high, count)
        costs = np.array([self._cost(camera, float(value), slice(None, None, step)) for value in values])
        valley = np.r_[True, costs[1:] <= costs[:-1]] & np.r_[costs[:-1] <= costs[1:], True]
        where = np.flatnonzero(valley)
        return values[where[np.argsort(costs[where])][:REFINED_MINIMA]].tolist()

    def _cost(self, camera: _Camera, value: float, part: slice) -> float:
        seen = self._seen(camera, value, part)
        e = np.where(seen.back, np.maximum(np.abs(seen.e + PLATE_M) - PLATE_M, 0.0), seen.e)
        told = seen.known & (seen.front | (seen.back & self._plate))
        near = np.maximum(3 * seen.sigma, SEARCH_STEP_M)  # or a value between two that are tried is missed
        cost = np.where(told, np.minimum((e / near) ** 2, 1.0), 1.0)
        return float(np.where(seen.through, THROUGH_COST, cost).mean())

    def _seen(self, camera: _Camera, value: float, part: slice) -> Sighting:
        """What the frame says about the part's points at a joint value."""
        p, n, way = self._moved(value, part)
        q, m = p @ camera.R.T + camera.t, n @ camera.R.T
        z = np.maximum(q[:, 2], 1e-3)
        u = np.rint(camera.K[0, 0] * q[:, 0] / z + camera.K[0, 2]).astype(int)
        v = np.rint(camera.K[1, 1] * q[:, 1] / z + camera.K[1, 2]).astype(int)
        h, w = camera.depth.shape
        ray = q / z[:, None]
        along = np.einsum("ni,ni->n", m, ray)
        cosine = along / np.linalg.norm(ray, axis=1)
        inside = (q[:, 2] > 0.05) & (u >= 0) & (u < w) & (v >= 0) & (v < h)
        pixel = np.where(inside, v, 0), np.where(inside, u, 0)
        measured, still = camera.depth[pixel], camera.still[pixel]
        known = inside & (measured > 0)
        ahead = measured - z
        sigma = noise_sigma(z)
        front, back = inside & (cosine < -FACING), inside & (cosine > FACING)
        through = known & (front | back) & (np.abs(along) * ahead > GATES_M[-1] + 3 * sigma)
        shows_still = known & (still > 0) & (np.abs(measured - still) < STILL_SIGMAS * sigma)
        through |= shows_still & (front | back) & (z < still + STILL_SIGMAS * sigma)
        return Sighting(
            along * ahead, np.einsum("ni,ni->n", n, way), sigma, front, back, known & ~shows_still, through
        )

    def _moved(self, value: float, part: slice) -> tuple[Array, Array, Array]:
        """Points, normals and velocity per joint value at a joint value."""
        motion, p, n = self._motion, carried(self._p[part], self._motion, value), self._n[part]
        if motion.joint_type == "prismatic":
            return p, n, np.broadcast_to(motion.direction, p.shape)
        R = rotation(motion.direction, value)
        return p, n @ R.T, np.cross(motion.direction, p - motion.origin)


def _require_surface(points: Array) -> None:
    """Refuse a part with too few points (n, 3)."""
    if len(points) < LEAST_POINTS:
        raise BadViewError(
            f"the part has {len(points)} points with a surface, tracking needs {LEAST_POINTS} or more"
        )


def _stands_alone(state: TrackedState) -> bool:
    """Whether a fit that no earlier value speaks for is to be believed."""
    return (
        state.value is not None
        and state.seen > ELSEWHERE_SEEN
        and state.through < ELSEWHERE_THROUGH
        and state.residual_m < ELSEWHERE_SPREAD_M
    )


def _best(near: TrackedState, elsewhere: list[TrackedState]) -> TrackedState:
    """The fit that the frame speaks for most: that of the last value unless another one is clearly better.

    Lost where the last value fits no more and two others, apart from each other, fit alike.
    """
    ranked = sorted(elsewhere, key=_merit, reverse=True)
    if near.value is not None:
        return ranked[0] if ranked and _merit(ranked[0]) - _merit(near) > CLEARLY else near
    if not ranked:
        return near
    best = ranked[0]
    for other in ranked[1:]:
        if _merit(best) - _merit(other) < CLEARLY and not _overlap(best, other):
            return replace(best, value=None, interval90=None)
    return best


def _merit(state: TrackedState) -> float:
    """How much more of the part the frame shows than it denies."""
    return state.seen - state.through


def _overlap(a: TrackedState, b: TrackedState) -> bool:
    """Whether two fits say the same value."""
    assert a.interval90 is not None
    assert b.interval90 is not None
    return a.interval90[0] <= b.interval90[1] and b.interval90[0] <= a.interval90[1]


class _Camera:
    """A frame made ready for projection."""

    def __init__(self, frame: DepthFrame, ignore: Mask | None, still: Array) -> None:
        self.depth = frame.depth_m if ignore is None else np.where(ignore, 0.0, frame.depth_m)
        self.K, self.still = frame.K, still
        R = frame.X_base_camera[:3, :3]
        self.R = R.T
        self.t = -R.T @ frame.X_base_camera[:3, 3]


_LOST = TrackedState(None, None, 0.0, 0.01)
