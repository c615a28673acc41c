"""From a joint path to a trajectory that the executor admits without a second try.

TOPP-RA (Pham and Pham, IEEE T-RO 2018) finds the fastest speed along the path under velocity, acceleration and
torque limits. Its acceleration jumps, so the speed profile is averaged over a short window, which bounds the jerk;
knots are taken from the averaged profile, the exact extrema of the quintics between them are measured, and the whole
is slowed by one factor until every limit holds. Of several windows the one with the shortest result wins.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from s2r_host.trajectory.path import length_at, smooth_path
from s2r_host.trajectory.torque import STANDARD_GRAVITY, InverseDynamics, torque_stretch
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError, check_positions
from s2r_host.trajectory.without_plots import toppra
from s2r_protocol.arms import ArmDescription

# TOPP-RA reports every step of its solver at warning level when a grid point is nearly singular.
logging.getLogger("toppra").setLevel(logging.ERROR)

_WINDOWS_S = (0.04, 0.08, 0.15, 0.25, 0.4)
_PROFILE_DT_S = 0.004
# Places at which TOPP-RA looks: more where a long path has corners to be seen.
_GRID, _FINEST_GRID = 201, 1000
# Of a profile: a way of hundredths of a milliradian is done in less than one interval of it.
_LEAST_SAMPLES = 4
_MIN_KNOT_DT_S = 0.008
_LOOKS_PER_SEGMENT = 4  # at the fingertip's speed
# The fingertip slows down over this stretch before the touch: the real part may be nearer than believed.
_SLOW_FROM_M, _SLOW_AT_M = 0.04, 0.015


@dataclass(frozen=True)
class TimeLawSettings:
    """How a path is timed.

    Attributes:
        share: Share of the velocity, acceleration and jerk limits that is used.
        torque_share: Share of the torque limits that is used.
        deviation_rad: How far the smoothed path may leave the straight lines between the given points.
        contact_speed_m_s: Fastest fingertip while it moves the part.
        contact_acceleration_m_s2: Its largest acceleration then. A part that is slowed less than its friction would
            slow it stays at the fingertip; a faster one coasts on, by an amount no model knows.
        speed: 1 is as fast as the limits allow; 0.5 takes twice the time.
        max_knots: Most knots of the result.
    """

    share: float = 0.95
    torque_share: float = 0.9
    deviation_rad: float = 0.004
    contact_speed_m_s: float = 0.10
    contact_acceleration_m_s2: float = 0.25
    speed: float = 1.0
    max_knots: int = 400

    def __post_init__(self) -> None:
        for name in ("share", "torque_share", "speed"):
            value = getattr(self, name)
            if not 0.0 < value <= 1.0:
                raise ValueError(
                    f"time law setting {name} = {value!r} is not allowed: it must be within (0, 1]"
                )
        if self.max_knots < 10:
            raise ValueError(f"time law setting max_knots = {self.max_knots} is not allowed: at least 10")


def time_law(
    q_path: np.ndarray,
    arm: ArmDescription,
    settings: TimeLawSettings | None = None,
    contact_row: int | None = None,
    gravity: np.ndarray | None = None,
) -> Trajectory:
    """Time a joint path within velocity, acceleration, jerk and torque limits, from rest to rest.

    Args:
        q_path: Joint positions [rad], (n, dof), e.g. the targets of a plan's control steps.
        arm: Its limits and dynamics.
        settings: See TimeLawSettings.
        contact_row: Row of the path at which the fingertip meets the part; None if it moves nothing.
        gravity: In the arm's base frame [m/s²], (3,); None: the arm stands upright.

    Returns:
        Knots whose quintic segments stay within the limits everywhere, zero velocity and acceleration at both ends.

    Raises:
        TrajectoryError: The path does not move, is not finite, leaves the position limits, or cannot be held
            against gravity.
    """
    settings = settings or TimeLawSettings()
    if np.ndim(q_path) == 2 and np.shape(q_path)[1] != arm.dof:
        raise TrajectoryError(f"the path has {np.shape(q_path)[1]} joints; arm {arm.name!r} has {arm.dof}")
    path = smooth_path(q_path, settings.deviation_rad)
    dynamics = InverseDynamics(arm, gravity)
    contact_at = np.inf
    if contact_row is not None:
        contact_at = length_at(np.asarray(q_path, dtype=float), contact_row) * path.x[-1]
    t, speed = _fastest(path, arm, dynamics, settings, contact_at)
    best: Trajectory | None = None
    for window_s in _WINDOWS_S:
        trajectory, x = _knots(path, _averaged(t, speed, path.x[-1], window_s), settings)
        stretch = limit_stretch(trajectory, arm, settings.share)
        if contact_row is not None:
            fastest = _tip_speed(trajectory, x >= contact_at, dynamics)
            stretch = max(stretch, fastest / settings.contact_speed_m_s, 1.0)
        trajectory = trajectory.stretched(stretch)
        if best is None or trajectory.duration_s < best.duration_s:
            best = trajectory
    assert best is not None
    stretch = torque_stretch(best, arm, dynamics, settings.torque_share)
    if gravity is not None and np.abs(np.asarray(gravity) - STANDARD_GRAVITY).max() > 0.05:
        # The executor believes that every arm stands upright; what it cannot admit is of no use.
        stretch = max(stretch, torque_stretch(best, arm, InverseDynamics(arm), settings.torque_share))
    best = best.stretched(stretch / settings.speed)
    check_positions(best, arm)
    return best


def limit_stretch(trajectory: Trajectory, arm: ArmDescription, share: float) -> float:
    """Factor that brings the largest of velocity, acceleration and jerk exactly to its share of the limit."""
    limits = arm.limits
    velocity = (trajectory.peak(1) / (share * limits.dq_max)).max()
    acceleration = (trajectory.peak(2) / (share * limits.ddq_max)).max()
    jerk = (trajectory.peak(3) / (share * limits.dddq_max)).max()
    # 1 + 1e-9: the limit itself must not be exceeded by a rounding error.
    return float(max(velocity, np.sqrt(acceleration), np.cbrt(jerk)) * (1.0 + 1e-9))


def _fastest(
    path: CubicSpline,
    arm: ArmDescription,
    dynamics: InverseDynamics,
    settings: TimeLawSettings,
    contact_at: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and speeds along the path [rad/s] of the time-optimal profile, at a grid over the path.

    The fingertip's way with the part is an additional coordinate beside the joints, with limits of its own.
    """
    limits = arm.limits
    grid = np.linspace(0.0, path.x[-1], max(_GRID, min(len(path.x), _FINEST_GRID)))
    joints = path(grid)
    way = np.zeros(len(grid))
    if np.isfinite(contact_at):
        tip_speed = np.linalg.norm(np.gradient(dynamics.tool_positions(joints), grid, axis=0), axis=1)
        tip_way = cumulative_trapezoid(tip_speed, grid, initial=0.0)
        before_m = np.interp(contact_at, grid, tip_way) - tip_way
        onset = np.clip((_SLOW_FROM_M - before_m) / (_SLOW_FROM_M - _SLOW_AT_M), 0.0, 1.0)
        way = cumulative_trapezoid(tip_speed * onset, grid, initial=0.0)
    # A little less than the torque share: the averaging moves accelerations along the path.
    tau = np.append(0.95 * settings.torque_share * limits.tau_max, 1.0)
    velocity = np.append(settings.share * limits.dq_max, settings.contact_speed_m_s)
    acceleration = np.append(settings.share * limits.ddq_max, settings.contact_acceleration_m_s2)
    constraints = [
        toppra.constraint.JointVelocityConstraint(_both_sides(velocity)),
        toppra.constraint.JointAccelerationConstraint(_both_sides(acceleration)),
        toppra.constraint.JointTorqueConstraint(_with_way(dynamics), _both_sides(tau), np.zeros(arm.dof + 1)),
    ]
    extended = toppra.SplineInterpolator(grid, np.column_stack([joints, way]), bc_type="natural")
    instance = toppra.algorithm.TOPPRA(constraints, extended, gridpoints=grid, solver_wrapper="seidel")
    speed = np.asarray(instance.compute_parameterization(0.0, 0.0)[1], dtype=float)  # NaN where it is None
    if not np.isfinite(speed).all():
        raise TrajectoryError(
            f"no speed along the path keeps arm {arm.name!r} within its limits: can it hold its weight everywhere?"
        )
    middle = np.maximum((speed[:-1] + speed[1:]) / 2.0, 1e-6)
    return np.concatenate([[0.0], np.cumsum(np.diff(grid) / middle)]), speed


def _both_sides(limit: np.ndarray) -> np.ndarray:
    return np.column_stack([-limit, limit])


def _with_way(dynamics: InverseDynamics) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Inverse dynamics of the joints, and nothing for the fingertip's way."""

    def torques(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        return np.append(dynamics(q[:-1], dq[:-1], ddq[:-1]), 0.0)

    return torques


def _averaged(t: np.ndarray, speed: np.ndarray, length: float, window_s: float) -> CubicSpline:
    """Speed over time, averaged twice over half a window; its integral is exactly the path's length."""
    dt = min(_PROFILE_DT_S, t[-1] / _LEAST_SAMPLES)
    half = max(1, round(window_s / 2.0 / dt))
    count = int(np.ceil(t[-1] / dt)) + 1
    samples = np.concatenate([np.interp(np.arange(count) * dt, t, speed), np.zeros(3)])
    kernel = np.ones(half + 1) / (half + 1)
    samples = np.convolve(np.convolve(samples, kernel), kernel)
    samples = np.concatenate([[0.0], samples, [0.0]])
    samples[[0, 1, -1, -2]] = 0.0
    profile = CubicSpline(np.arange(len(samples)) * dt, samples, bc_type="clamped")
    travelled = float(profile.integrate(0.0, profile.x[-1]))
    return CubicSpline(profile.x * (length / travelled), samples, bc_type="clamped")


def _knots(
    path: CubicSpline, profile: CubicSpline, settings: TimeLawSettings
) -> tuple[Trajectory, np.ndarray]:
    """Positions, velocities and accelerations at even times, by the chain rule, and the path length there, (n,)."""
    duration_s = float(profile.x[-1])
    count = int(np.clip(np.ceil(duration_s / _MIN_KNOT_DT_S), 10, settings.max_knots - 1)) + 1
    t = np.linspace(0.0, duration_s, count)
    travelled = profile.antiderivative()
    x = np.clip(travelled(t), 0.0, path.x[-1])[:, None]
    dx, ddx = profile(t)[:, None], profile(t, 1)[:, None]
    x[0], x[-1], dx[[0, -1]], ddx[[0, -1]] = 0.0, path.x[-1], 0.0, 0.0
    q, slope, bend = path(x[:, 0]), path(x[:, 0], 1), path(x[:, 0], 2)
    return Trajectory(t, q, slope * dx, bend * dx**2 + slope * ddx), x[:, 0]


def _tip_speed(trajectory: Trajectory, rows: np.ndarray, dynamics: InverseDynamics) -> float:
    """Largest speed of the fingertip at and between neighbouring knots among the marked ones [m/s]."""
    if rows.sum() < 2:
        return 0.0
    t = trajectory.t[rows]
    times = np.interp(np.arange(0.0, len(t) - 1 + 1e-9, 1.0 / _LOOKS_PER_SEGMENT), np.arange(len(t)), t)
    q, dq, _ = trajectory.sample(times)
    return max(float(np.linalg.norm(dynamics.tool_jacobian(at) @ v)) for at, v in zip(q, dq, strict=True))
