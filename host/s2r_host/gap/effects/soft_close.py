"""Soft close: a one-way damper over the last part of the travel."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.session import Session


class SoftClose(Effect):
    """tau = b dq while the joint is beyond q0 and still going there."""

    name = "soft_close"
    model_error = {"damping": 0.04}  # noqa: RUF012
    equation = "tau = b dq for side (q - q0) > 0 and side dq > 0"
    signature = "proportional to speed, near one end, in one direction"
    separating_motion = "open and close at two speeds"
    confusable = ("soft_end_stop", "viscous_friction", "asymmetric_friction")

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Edges over the outer 60 % of the travel, both ends."""
        low, high = ctx.span(joint)
        travel = high - low
        share = (0.05, 0.1, 0.15, 0.2, 0.27, 0.35, 0.45, 0.6)
        ends = [(low + travel * x, -1.0) for x in share] + [(high - travel * x, 1.0) for x in share]
        return [{"q0": q0, "side": side, "ramp": travel * r} for q0, side in ends for r in (0.01, 0.06)]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Edge, linear."""
        low, high = ctx.span(joint)
        return {"q0": ("linear", (high - low) * 0.02), "ramp": ("log", 0.4)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """A ramp between a sharp edge and a fifth of the travel."""
        low, high = ctx.span(joint)
        return {"ramp": (0.005 * (high - low), 0.2 * (high - low))}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Speed inside the zone and on the way in."""
        v, side = s.v[:, joint], shape["side"]
        inside = _zone(side * (s.q[:, joint] - shape["q0"]), shape["ramp"])
        return Columns([v * inside * (side * v > 0)], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Where the damper begins, and its damping once it is fully in."""
        name = ctx.model.joints[joint]
        unit = ctx.model.unit(name)
        return {
            "position": Value(shape["q0"], unit, shape_key="q0", error=0.12 * shape["ramp"]),
            "damping": Value(float(theta[0]), f"{ctx.model.effort_unit(name)}·s/{unit}", (1.0,)),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """One-way damper."""
        b, q0, side, ramp = float(theta[0]), shape["q0"], shape["side"], shape["ramp"]

        def step(state: StepState) -> tuple[float, float]:
            v = float(state.v[joint])
            if side * v <= 0:
                return 0.0, 0.0
            return b * v * float(_zone(np.asarray(side * (state.q[joint] - q0)), ramp)), 0.0

        return step


def _zone(depth: np.ndarray, ramp: float) -> np.ndarray:
    return np.clip(depth / (ramp + 1e-12), 0.0, 1.0)


EFFECT = SoftClose()
