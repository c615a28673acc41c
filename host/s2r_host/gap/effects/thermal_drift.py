"""Friction or drive gain that drifts while the machine warms up."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.session import Session

FRICTION, DAMPING, GAIN = 0.0, 1.0, 2.0
WORD = {FRICTION: "friction", DAMPING: "damping", GAIN: "gain"}


class ThermalDrift(Effect):
    """tau = c (1 - exp(-t/T)) times sgn(dq), dq or load; with a temperature channel (temp - temp0) instead of time."""

    name = "thermal_drift"
    equation = "tau = c (1 - exp(-t/T)) {sgn dq | dq | load}"
    signature = "one regressor whose coefficient drifts over the recording"
    separating_motion = "repeat the first motion at the end"
    confusable = ("session_friction", "payload")
    contains = ("coulomb_friction", "viscous_friction")

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Needs some length."""
        longest = max(float(s.t[-1]) for s in ctx.sessions)
        return None if longest > 5.0 else f"the longest recording lasts {longest:.1f} s"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Three targets; time constants as shares of the longest recording."""
        longest = max(float(s.t[-1]) for s in ctx.sessions)
        times = (0.1, 0.3, 1.0, 4.0)
        if self._temperature(ctx, ctx.sessions[0], joint) is not None:
            times = (1.0,)
        return [{"T": longest * x, "target": target} for x in times for target in (FRICTION, DAMPING, GAIN)]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Time constant on a log scale."""
        return {"T": ("log", 0.4)}

    def _temperature(self, ctx: Context, s: Session, joint: int) -> np.ndarray | None:
        return s.channel("temp", ctx.model.joints[joint])

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Drift times what drifts."""
        temperature = self._temperature(ctx, s, joint)
        drift = 1.0 - np.exp(-s.t / shape["T"]) if temperature is None else temperature - temperature[0]
        target = shape["target"]
        what = (
            s.sign(joint) if target == FRICTION else s.v[:, joint] if target == DAMPING else s.load[:, joint]
        )
        linear, positive = [drift * what], [False]
        model = ctx.model.model
        if target == FRICTION and not model.dof_frictionloss[joint]:
            linear.append(what)
            positive.append(True)
        if target == DAMPING and not model.dof_damping[joint]:
            linear.append(what)
            positive.append(True)
        return Columns(linear, tuple(positive))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Final change and time constant."""
        unit = {FRICTION: ctx.model.effort_unit(ctx.model.joints[joint]), DAMPING: "N·m·s/rad", GAIN: "1"}[
            shape["target"]
        ]
        g = (1.0, 0.0)[: len(theta)]
        return {
            f"{WORD[shape['target']]}_change": Value(float(theta[0]), unit, g),
            "time_constant": Value(shape["T"], "s", shape_key="T"),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Time-dependent force or friction loss."""
        c, T, target = float(theta[0]), shape["T"], shape["target"]
        flat = float(theta[1]) if len(theta) > 1 else 0.0

        def step(state: StepState) -> tuple[float, float]:
            now = flat + c * (1.0 - float(np.exp(-state.t / T)))
            if target == FRICTION:
                return 0.0, now
            return now * float(state.v[joint] if target == DAMPING else state.load[joint]), 0.0

        return step


EFFECT = ThermalDrift()
