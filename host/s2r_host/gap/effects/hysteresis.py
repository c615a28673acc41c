"""Hysteresis of a harmonic drive: a wide rate-independent loop in torque against angle (Bouc-Wen)."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, Value
from s2r_host.gap.effects.presliding import bristle_force
from s2r_host.gap.motion.quantities import SINCE_TURN
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.states import bristle

LOOPS = ((1.0, 1.0), (1.0, 0.5), (2.0, 0.5))  # exponent n and beta


class Hysteresis(Effect):
    """tau = h z, dz/dq = (1 - |z|^n (beta sgn(z dq) + 1 - beta))/zs."""

    name = "hysteresis"
    model_error = {"displacement": 0.06, "level": 0.05, "beta": 0.1}  # noqa: RUF012
    equation = "tau = h z, dz/dq = (1 - |z|^n (beta sgn(z dq) + 1 - beta))/zs"
    signature = "a loop of residual against position as wide as the motion, the same at all speeds"
    separating_motion = "sine motions of several amplitudes"
    confusable = ("presliding", "cable_spring", "backlash")
    shows_over = SINCE_TURN

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Needs reversals."""
        return None if ctx.turns(joint) >= 2 else "fewer than two reversals"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Displacements from 5 % to 60 % of the motion; loops that turn back like Dahl's or straight, two exponents."""
        low, high = ctx.span(joint)
        return [
            {"width": (high - low) * x, "power": n, "beta": beta}
            for x in (0.05, 0.12, 0.3, 0.6)
            for n, beta in LOOPS
        ]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Displacement on a log scale, and how straight the loop turns back."""
        return {"width": ("log", 0.3), "beta": ("linear", 0.1)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """A narrower loop is called presliding, a wider one never closes: a spring; beta 1/2 turns straight back."""
        low, high = ctx.span(joint)
        return {"width": (0.04 * (high - low), high - low), "beta": (0.5, 1.0)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Loop state."""
        z = bristle(s, joint, np.array([shape["width"]]), int(shape["power"]), shape["beta"])
        return Columns([z[:, 0]], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Level, displacement, exponent and beta."""
        name = ctx.model.joints[joint]
        return {
            "level": Value(float(theta[0]), ctx.model.effort_unit(name), (1.0,)),
            "displacement": Value(shape["width"], ctx.model.unit(name), shape_key="width"),
            "exponent": Value(shape["power"], "1"),
            "beta": Value(shape["beta"], "1", shape_key="beta"),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Loop state as applied force."""
        return bristle_force(joint, shape["width"], int(shape["power"]), theta, dt, shape["beta"])


EFFECT = Hysteresis()
