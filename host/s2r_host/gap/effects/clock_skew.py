"""Position and effort were stamped by different clocks."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value
from s2r_host.gap.motion.quantities import EFFORT_SLOPE
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.states import delayed

STEP_S = 0.01
EXCLUDED = 1e4  # log odds: a record that obeys the law on time was stamped by one clock


class ClockSkew(Effect):
    """recorded q(t) = q(t - lag), while the controller saw q(t)."""

    name = "clock_skew"
    equation = "recorded q(t) = q(t - lag)"
    signature = "a lag between channels that does not change the damping of the loop"
    separating_motion = "a step; compare the controller's own equation with the record"
    confusable = ("actuator_delay", "bandwidth")
    shows_over = EFFORT_SLOPE
    side = "sensor"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Both signs, 2 to 80 ms."""
        return [
            {"lag": sign * x} for x in (0.002, 0.004, 0.008, 0.014, 0.025, 0.04, 0.08) for sign in (1.0, -1.0)
        ]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Lag, linear."""
        return {"lag": ("linear", 0.003)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Load of the motion as it really was minus load of the recorded one."""
        if len(ctx.model.joints) > 1:
            slope, bend = self._series(ctx, s, joint)
            return Columns([], fixed=shape["lag"] * slope + shape["lag"] ** 2 * bend)
        load = s.load[:, joint]
        return Columns([], fixed=delayed(load, -shape["lag"], s.dt) - load)

    def _series(self, ctx: Context, s: Session, joint: int) -> tuple[np.ndarray, np.ndarray]:
        """Change of all loads per second by which one joint's motion came later, to second order."""
        key = ("late", joint)
        if key not in s.cache:
            ends = []
            for shift in (STEP_S, -STEP_S):
                q, v, a = s.q.copy(), s.v.copy(), s.a.copy()
                for x in (q, v, a):
                    x[:, joint] = delayed(x[:, joint], -shift, s.dt)
                ends.append(ctx.model.inverse(q, v, a) - s.load)
            s.cache[key] = (ends[0] - ends[1]) / (2.0 * STEP_S), (ends[0] + ends[1]) / (2.0 * STEP_S**2)
        return s.cache[key]

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """The control law, recomputed from the record, shows whether the clocks differ."""
        lag = ctx.control_lag.get(joint)
        return 0.0 if lag is None else -min(EXCLUDED, 0.5 * ((shape["lag"] - lag[0]) / lag[1]) ** 2)

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Lag of the position behind the effort."""
        return {"lag": Value(shape["lag"], "s", shape_key="lag")}


EFFECT = ClockSkew()
