"""The effort acts later than it was asked for."""

from __future__ import annotations

from collections import deque

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import EFFORT_SLOPE
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.states import delayed

LAW_ODDS = 200.0  # most that the control law may say against a difference of clocks, or for it


class ActuatorDelay(Effect):
    """applied(t) = u(t - delay)."""

    name = "actuator_delay"
    equation = "applied(t) = u(t - delay)"
    signature = "residual like the slope of the effort, phase linear in frequency"
    separating_motion = "a chirp and a step of the commanded effort"
    confusable = ("bandwidth", "clock_skew", "joint_elasticity")
    shows_over = EFFORT_SLOPE
    side = "actuator"

    def applies(self, ctx: Context, joint: int) -> bool:
        """Measured effort is what arrived: no delay is left in it."""
        return any(s.rec.effort == "commanded" for s in ctx.sessions)

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """From one millisecond to 80."""
        return [
            {"delay": x} for x in (0.001, 0.002, 0.003, 0.005, 0.008, 0.012, 0.018, 0.027, 0.04, 0.06, 0.08)
        ]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Delay on a log scale."""
        return {"delay": ("log", 0.2)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """What was asked minus what arrived."""
        u = s.drive(joint)
        return Columns([], fixed=u - delayed(u, shape["delay"], s.dt))

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """The control law, recomputed from the record, shows whether the clocks differ."""
        return -skew_seen(ctx, joint)

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Delay."""
        return {"delay": Value(shape["delay"], "s", shape_key="delay")}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """A queue of past efforts, read between two entries."""
        steps = shape["delay"] / dt
        whole, rest = int(steps), steps - int(steps)
        past: deque[float] = deque(maxlen=whole + 2)

        def step(state: StepState) -> tuple[float, float]:
            u = float(state.u[joint])
            past.append(u)
            newer = past[-1 - whole] if len(past) > whole else past[0]
            older = past[-2 - whole] if len(past) > whole + 1 else past[0]
            return u - ((1.0 - rest) * newer + rest * older), 0.0

        return step


def skew_seen(ctx: Context, joint: int) -> float:
    """Log odds for a clock difference from the control law: 0 when it is unknown or on time."""
    lag = ctx.control_lag.get(joint)
    return 0.0 if lag is None else min(LAW_ODDS, 0.5 * (lag[0] / lag[1]) ** 2)


EFFECT = ActuatorDelay()
