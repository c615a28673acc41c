"""Detent or magnetic latch: a narrow pull towards one position."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import POSITION
from s2r_host.gap.motion.session import Session


class Detent(Effect):
    """tau = F (x/w) exp(1/2 - x²/(2 w²)), x = q - q0: peak F at x = ±w."""

    name = "detent"
    equation = "tau = F (x/w) exp(1/2 - x²/(2w²)), x = q - q0"
    signature = "a narrow pull with a sign change, a break-away peak beside it"
    separating_motion = "slow approach from both sides"
    confusable = ("soft_end_stop", "cogging", "stribeck")
    shows_over = POSITION
    foreign_is = "a force that stays on beyond its place"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Positions over the travel, three widths."""
        low, high = ctx.span(joint)
        travel = high - low
        centres = np.linspace(low, high, 33)
        return [{"q0": float(c), "w": travel * w} for c in centres for w in (0.012, 0.03, 0.07)]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Position linear, width on a log scale."""
        low, high = ctx.span(joint)
        return {"q0": ("linear", (high - low) / 64.0), "w": ("log", 0.3)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Derivative of a Gaussian well."""
        return Columns([_pull(s.q[:, joint], shape["q0"], shape["w"])], (True,))

    def foreign(
        self, ctx: Context, s: Session, joint: int, shape: Shape, theta: np.ndarray
    ) -> np.ndarray | None:
        """A step from one peak to the other: a body that is picked up at the place weighs on from there."""
        return theta[0] * np.sign(s.q[:, joint] - shape["q0"])

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Position, width, peak."""
        name = ctx.model.joints[joint]
        return {
            "position": Value(shape["q0"], ctx.model.unit(name), shape_key="q0"),
            "width": Value(shape["w"], ctx.model.unit(name), shape_key="w"),
            "peak": Value(float(theta[0]), ctx.model.effort_unit(name), (1.0,)),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Force of position."""
        peak, q0, w = float(theta[0]), shape["q0"], shape["w"]

        def step(state: StepState) -> tuple[float, float]:
            return peak * float(_pull(np.asarray(state.q[joint]), q0, w)), 0.0

        return step


def _pull(q: np.ndarray, q0: float, w: float) -> np.ndarray:
    x = (q - q0) / w
    return x * np.exp(0.5 - 0.5 * x**2)


EFFECT = Detent()
