"""Cable or hose: a spring with a loop from bending friction."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.effects.presliding import bristle_force
from s2r_host.gap.effects.spring_return import spring_values
from s2r_host.gap.session import Session
from s2r_host.gap.states import bristle


class CableSpring(Effect):
    """tau = k (q - q0) + Fb z."""

    name = "cable_spring"
    model_error = {"stiffness": 0.6}  # noqa: RUF012
    equation = "tau = k (q - q0) + Fb z, dz/dq = (1 - z sgn dq)/zs"
    signature = "slow function of position with a loop at reversals"
    separating_motion = "unplug the cable, or repeat at another wrist angle"
    confusable = ("spring_return", "payload", "hysteresis")
    contains = ("spring_return",)

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Loop widths as shares of the motion."""
        low, high = ctx.span(joint)
        return [{"width": (high - low) * x} for x in (0.02, 0.05, 0.12, 0.3)]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Loop width on a log scale."""
        return {"width": ("log", 0.35)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Position, constant, loop."""
        z = bristle(s, joint, np.array([shape["width"]]))[:, 0]
        return Columns([s.q[:, joint], np.ones(len(s.t)), z], (True, False, True))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Spring and loop height."""
        found = spring_values(ctx, joint, theta)
        unit = ctx.model.effort_unit(ctx.model.joints[joint])
        found["bending_friction"] = Value(float(theta[2]), unit, (0.0, 0.0, 1.0))
        return found

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Spring and loop as force."""
        loop = bristle_force(joint, shape["width"], 1, theta[2:], dt)
        k, c = float(theta[0]), float(theta[1])

        def step(state: StepState) -> tuple[float, float]:
            return k * float(state.q[joint]) + c + loop(state)[0], 0.0

        return step


EFFECT = CableSpring()
