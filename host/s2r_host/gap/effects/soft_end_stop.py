"""A soft end stop: nothing, then a spring with damping."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import POSITION
from s2r_host.gap.motion.session import Session

OUTER_SHARE, DEEP = 0.25, -100.0  # share of the travel a stop usually takes, log odds per share beyond it


class SoftEndStop(Effect):
    """tau = k x + d x dq for x = depth beyond q0 (side ±1)."""

    name = "soft_end_stop"
    equation = "tau = side (k x + d x (side dq)), x = max(0, side (q - q0))"
    signature = "residual only beyond one position"
    separating_motion = "push in slowly, then at speed"
    confusable = ("detent", "saturation", "soft_close")
    shows_over = POSITION

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Edges in the outer 40 % of the travel, both sides."""
        low, high = ctx.span(joint)
        travel = high - low
        depth = (0.01, 0.02, 0.04, 0.07, 0.11, 0.16, 0.22, 0.3, 0.4)
        return [{"q0": high - travel * x, "side": 1.0} for x in depth] + [
            {"q0": low + travel * x, "side": -1.0} for x in depth
        ]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Edge, linear."""
        low, high = ctx.span(joint)
        return {"q0": ("linear", (high - low) * 0.01)}

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """What pushes back over a good part of the travel is a spring and no stop."""
        low, high = ctx.span(joint)
        end = high if shape["side"] > 0 else low
        share = shape["side"] * (end - shape["q0"]) / max(high - low, 1e-12)
        return DEEP * max(0.0, share - OUTER_SHARE)

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Depth, and depth times speed."""
        x = np.maximum(0.0, shape["side"] * (s.q[:, joint] - shape["q0"]))
        return Columns([shape["side"] * x, x * s.v[:, joint]], (True, True))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Edge, stiffness, damping per depth."""
        name = ctx.model.joints[joint]
        unit, effort = ctx.model.unit(name), ctx.model.effort_unit(name)
        return {
            "position": Value(shape["q0"], unit, shape_key="q0"),
            "stiffness": Value(float(theta[0]), f"{effort}/{unit}", (1.0, 0.0)),
            "damping": Value(float(theta[1]), f"{effort}·s/{unit}²", (0.0, 1.0)),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Force beyond the edge."""
        k, d, q0, side = float(theta[0]), float(theta[1]), shape["q0"], shape["side"]

        def step(state: StepState) -> tuple[float, float]:
            x = max(0.0, side * (float(state.q[joint]) - q0))
            return side * k * x + d * x * float(state.v[joint]), 0.0

        return step


EFFECT = SoftEndStop()
