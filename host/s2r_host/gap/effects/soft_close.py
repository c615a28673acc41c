"""Soft close: a one-way damper over the last part of the travel."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.session import Session


class SoftClose(Effect):
    """tau = b dq while the joint is beyond q0 and still going there."""

    name = "soft_close"
    equation = "tau = b dq for side (q - q0) > 0 and side dq > 0"
    signature = "proportional to speed, near one end, in one direction"
    separating_motion = "open and close at two speeds"
    confusable = ("soft_end_stop", "viscous_friction", "asymmetric_friction")

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Edges over the outer 60 % of the travel, both ends."""
        low, high = ctx.span(joint)
        travel = high - low
        share = (0.05, 0.1, 0.15, 0.2, 0.27, 0.35, 0.45, 0.6)
        return [{"q0": low + travel * x, "side": -1.0} for x in share] + [
            {"q0": high - travel * x, "side": 1.0} for x in share
        ]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Edge, linear."""
        low, high = ctx.span(joint)
        return {"q0": ("linear", (high - low) * 0.02)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Speed inside the zone and on the way in."""
        v, side = s.v[:, joint], shape["side"]
        inside = _zone(side * (s.q[:, joint] - shape["q0"]), 0.01 * (ctx.span(joint)[1] - ctx.span(joint)[0]))
        return Columns([v * inside * (side * v > 0)], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Edge and damping."""
        name = ctx.model.joints[joint]
        unit = ctx.model.unit(name)
        return {
            "position": Value(shape["q0"], unit, shape_key="q0"),
            "damping": Value(float(theta[0]), f"{ctx.model.effort_unit(name)}·s/{unit}", (1.0,)),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """One-way damper."""
        b, q0, side = float(theta[0]), shape["q0"], shape["side"]
        edge = 0.01 * (ctx.span(joint)[1] - ctx.span(joint)[0])

        def step(state: StepState) -> tuple[float, float]:
            v = float(state.v[joint])
            if side * v <= 0:
                return 0.0, 0.0
            return b * v * float(_zone(np.asarray(side * (state.q[joint] - q0)), edge)), 0.0

        return step


def _zone(depth: np.ndarray, edge: float) -> np.ndarray:
    return np.clip(0.5 + depth / (2.0 * edge + 1e-12), 0.0, 1.0)


EFFECT = SoftClose()
