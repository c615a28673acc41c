"""Clocks: does the recorded position lag behind the one the controller used?

Under delay or bandwidth of the drive the control law recomputed from the record fits at lag zero; under a clock
difference it fits at that difference. This is the only equation that tells the two apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, lowpass

MAX_LAG_S = 0.1


@dataclass(frozen=True)
class LawParts:
    """Terms of the declared control law along a session, each of shape (time,), and the limits of the drive."""

    kp: np.ndarray
    kd: np.ndarray
    rest: np.ndarray
    low: float
    high: float

    def total(self) -> np.ndarray:
        """Effort the law asks for, clipped as the model says."""
        return np.clip(self.kp + self.kd + self.rest, self.low, self.high)


def law_parts(model: RigidModel, s: Session, joint: int, lag_s: float = 0.0) -> LawParts | None:
    """Terms of the declared law from the recorded motion shifted by ``lag_s``; None when it is not known."""
    name = model.joints[joint]
    law = s.rec.controller
    command = s.channel("q_cmd", name)
    if law.kind not in ("pd", "pid", "position_servo") or name not in law.kp or command is None:
        return None
    if s.rec.rows is not None and law.ki.get(name):
        return None  # what an integral summed up between the rows of a slow log is not recorded
    grid = np.arange(len(s.t)) * s.dt
    speed = s.channel("dq", name)
    q = np.interp(grid + lag_s, grid, s.q_raw[:, joint])
    v = np.interp(grid + lag_s, grid, s.v[:, joint] if speed is None else speed)
    dq_cmd = s.channel("dq_cmd", name)
    if dq_cmd is None:
        dq_cmd = unlogged_speed(law.kind, command, grid)
    rest = np.zeros(len(grid))
    if law.ki.get(name):
        # The law sums once per tick of its own rate; between the rows kept, the trapezoid is the better guess.
        tick = min(s.dt, 1.0 / law.rate_hz) if law.rate_hz else s.dt
        rest = law.ki[name] * (np.cumsum(command - q) * s.dt - 0.5 * (command - q) * (s.dt - tick))
    ahead = s.channel("tau_ff", name)
    low, high = model.effort_limits()
    return LawParts(
        law.kp[name] * (command - q), law.kd.get(name, 0.0) * (dq_cmd - v),
        rest if ahead is None else rest + ahead, float(low[joint]), float(high[joint]),
    )  # fmt: skip


def unlogged_speed(kind: str, q_cmd: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Commanded speed of a law where none was logged: how fast the command goes; a position servo uses none."""
    return np.zeros(len(t)) if kind == "position_servo" else CubicSpline(t, q_cmd)(t, 1)


def control_law(model: RigidModel, s: Session, joint: int, lag_s: float = 0.0) -> np.ndarray | None:
    """Effort the declared law asks for, from the recorded motion shifted by ``lag_s``; None when it is not known.

    Returns:
        Effort without the integral part's unknown start, shape (time,).
    """
    parts = law_parts(model, s, joint, lag_s)
    return None if parts is None else parts.total()


def control_lag(model: RigidModel, sessions: list[Session], joint: int) -> tuple[float, float] | None:
    """Lag that makes the control law fit the recorded effort, with its standard deviation [s].

    Returns:
        None when the effort is not the commanded one, a law is not known, or it does not fit at any lag.
    """
    usable = [s for s in sessions if s.has_drive[joint] and s.rec.effort == "commanded"]
    if not usable or any(control_law(model, s, joint) is None for s in usable):
        return None
    lags = np.linspace(-MAX_LAG_S, MAX_LAG_S, 81)
    cost = np.array([_misfit(model, usable, joint, lag) for lag in lags])
    best = int(np.argmin(cost))
    if cost[best] > 0.3:
        return None
    fine = lags[best] + np.linspace(-1, 1, 21) * (lags[1] - lags[0])
    values = np.array([_misfit(model, usable, joint, lag) for lag in fine])
    lag = float(fine[int(np.argmin(values))])
    if values.min() > 0.7 * _misfit(model, usable, joint, 0.0):
        lag = 0.0
    return lag, 0.0005 + 0.1 * abs(lag)


def _misfit(model: RigidModel, sessions: list[Session], joint: int, lag: float) -> float:
    total, scale = 0.0, 0.0
    for s in sessions:
        law = control_law(model, s, joint, lag)
        assert law is not None
        margin = int(MAX_LAG_S / s.dt) + 1
        cut = min(10.0, s.rec.band_hz)
        error = lowpass(law - s.drive(joint), cut, s.dt)[margin:-margin]
        ramp = np.stack([np.ones(len(error)), np.linspace(-1, 1, len(error))], axis=1)
        error = error - ramp @ np.linalg.lstsq(ramp, error, rcond=None)[0]  # an integrator's start value
        total += float(error @ error)
        scale += float(np.sum((s.drive(joint)[margin:-margin] - np.mean(s.drive(joint))) ** 2))
    return total / max(scale, 1e-30)
