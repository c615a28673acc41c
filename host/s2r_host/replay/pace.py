"""How a plan is replayed: slower, or cut in two at a time, with rest between the two parts of the same path."""

from __future__ import annotations

import numpy as np

from s2r_host.errors import TargetError
from s2r_host.trajectory import Trajectory

RAMP_S = 0.6
_RAMP_KNOT_S = 0.01


def slowed(trajectory: Trajectory, speed: float) -> Trajectory:
    """The same path at a share of its speed.

    Raises:
        TargetError: The share is outside (0, 1].
    """
    if not 0.0 < speed <= 1.0:
        raise TargetError(f"replay speed {speed:g} is outside (0, 1]; faster than recorded is never played")
    return trajectory.stretched(1.0 / speed)


def from_time(trajectory: Trajectory, t_start: float) -> Trajectory:
    """The rest of a plan, begun from rest at ``t_start`` [s].

    Path time s runs after the ramp at its own rate: its rate rises as S(x) = 6x⁵ − 15x⁴ + 10x³ over 0.6 s, so that
    velocity and acceleration follow by the chain rule and no joint leaves the recorded path.

    Raises:
        TargetError: The time is outside the plan.
    """
    duration = trajectory.duration_s
    if not 0.0 <= t_start < duration:
        raise TargetError(f"--from {t_start:g} s is outside the plan's [0, {duration:.2f}) s")
    if t_start == 0.0:
        return trajectory
    ramp = min(RAMP_S, 2.0 * (duration - t_start) * 0.9)
    tau = np.append(np.arange(0.0, ramp, _RAMP_KNOT_S), ramp)
    x = tau / ramp
    rate = 10 * x**3 - 15 * x**4 + 6 * x**5
    rate_dot = (30 * x**2 - 60 * x**3 + 30 * x**4) / ramp
    s = t_start + ramp * (2.5 * x**4 - 3.0 * x**5 + x**6)  # the integral of the rate
    q, dq, ddq = trajectory.sample(s)
    velocity = dq * rate[:, None]
    acceleration = ddq * rate[:, None] ** 2 + dq * rate_dot[:, None]
    later = trajectory.t > s[-1] + 1e-3
    return Trajectory(
        np.concatenate([tau, trajectory.t[later] - s[-1] + ramp]),
        np.vstack([q, trajectory.q[later]]),
        np.vstack([velocity, trajectory.dq[later]]),
        np.vstack([acceleration, trajectory.ddq[later]]),
    )


def until_time(trajectory: Trajectory, t_end: float) -> Trajectory:
    """The plan up to ``t_end`` [s], where it comes to rest: the mirror image of :func:`from_time`.

    Raises:
        TargetError: The time is outside the plan.
    """
    return _backwards(from_time(_backwards(trajectory), trajectory.duration_s - t_end))


def _backwards(trajectory: Trajectory) -> Trajectory:
    later = slice(None, None, -1)
    return Trajectory(
        trajectory.duration_s - trajectory.t[later],
        trajectory.q[later],
        -trajectory.dq[later],
        trajectory.ddq[later],
    )


def path_time(t: np.ndarray, t_start: float, speed: float, duration_s: float) -> np.ndarray:
    """Which time of the recorded plan is reached at times ``t`` of the replay, shape of ``t``."""
    slowed_t = np.asarray(t, float) * speed
    if t_start == 0.0:
        return slowed_t
    ramp = min(RAMP_S, 2.0 * (duration_s - t_start) * 0.9)
    x = np.clip(slowed_t / ramp, 0.0, 1.0)
    begun = ramp * (2.5 * x**4 - 3.0 * x**5 + x**6)
    return t_start + begun + np.maximum(slowed_t - ramp, 0.0)
