"""The declared control law tick by tick, for simulations that have it inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from s2r_host.gap.motion.align import control_law, unlogged_speed
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session


@dataclass(frozen=True)
class Servo:
    """Gains in SI, and what the law is told at every tick, each of shape (ticks,).

    Attributes:
        ticks: Of the law, to a row of the work grid.
        ahead: What is fed forward [N·m or N].
    """

    kp: float
    kd: float
    ki: float
    ticks: int
    q_cmd: np.ndarray
    dq_cmd: np.ndarray
    ahead: np.ndarray

    def without_integral(self, i: int, q: float, v: float) -> float:
        """What is asked for at tick ``i`` from position, speed and what is fed forward [N·m or N]."""
        return self.kp * (self.q_cmd[i] - q) + self.kd * (self.dq_cmd[i] - v) + self.ahead[i]

    def integral(self, s: Session, joint: int, start: int) -> float:
        """What the law has summed up by row ``start``, from the recorded effort [rad s or m s]."""
        if not self.ki:
            return 0.0
        asked = self.without_integral(start * self.ticks, s.q[start, joint], s.v[start, joint])
        return float(s.drive(joint)[start] - asked) / self.ki


def ticks_of(s: Session) -> int:
    """Ticks of the law to a row of the work grid; without a declared rate one."""
    rate = s.rec.controller.rate_hz
    return max(1, round(s.dt * rate)) if rate else 1


def servo_of(rigid: RigidModel, s: Session, joint: int, ticks: int = 1) -> Servo | None:
    """The law of a joint, None where it is not known."""
    if control_law(rigid, s, joint) is None:
        return None
    name, law = rigid.joints[joint], s.rec.controller
    q_cmd = s.channel("q_cmd", name)
    assert q_cmd is not None
    fine = np.arange(len(s.t) * ticks) * (s.dt / ticks)
    dq_cmd, ahead = s.channel("dq_cmd", name), s.channel("tau_ff", name)
    if dq_cmd is not None:
        between = CubicHermiteSpline(s.t, q_cmd, dq_cmd)(np.minimum(fine, s.t[-1]))
    else:
        between = np.interp(fine, s.t, q_cmd)
        dq_cmd = unlogged_speed(law.kind, q_cmd, s.t)
    return Servo(
        law.kp[name], law.kd.get(name, 0.0), law.ki.get(name, 0.0), ticks, between, np.interp(fine, s.t, dq_cmd),
        np.zeros(len(fine)) if ahead is None else np.interp(fine, s.t, ahead),
    )  # fmt: skip
