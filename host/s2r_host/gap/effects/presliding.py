"""Presliding: friction builds up over a small displacement after each reversal."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import SINCE_TURN
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.states import bristle

SHARES = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.015, 0.03)
# Of the motion: what creeps so little while it comes to rest is no loop that a reversal shows.
SLIVER = 2.5e-4


class Presliding(Effect):
    """tau = Fc z, dz/dq = (1 - z sgn(dq)) / zs (Dahl)."""

    name = "presliding"
    equation = "tau = Fc z, dz/dq = (1 - z sgn dq)/zs"
    signature = "a loop of residual against position at each reversal, narrower than the motion"
    separating_motion = "reversals of small and smaller amplitude at two loads"
    confusable = ("hysteresis", "backlash")
    shows_over = SINCE_TURN
    contains = ("coulomb_friction",)

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Needs reversals."""
        return None if ctx.turns(joint) >= 2 else "fewer than two reversals"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Displacements from the encoder step up to 3 % of the motion."""
        low, high = ctx.span(joint)
        least = 2.0 * max(float(s.q_lsb[joint]) for s in ctx.sessions)
        return [{"width": (high - low) * x} for x in SHARES if (high - low) * x > least] or [{"width": least}]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Displacement on a log scale."""
        return {"width": ("log", 0.35)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """Narrower than a few encoder steps or a sliver of the motion it is Coulomb friction, wider hysteresis."""
        low, high = ctx.span(joint)
        least = max(2.0 * max(float(s.q_lsb[joint]) for s in ctx.sessions), SLIVER * (high - low))
        return {"width": (least, 0.05 * (high - low))}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Bristle state; where the model has dry friction it may be replaced."""
        z = bristle(s, joint, np.array([shape["width"]]))[:, 0]
        if float(ctx.model.model.dof_frictionloss[joint]) > 0.0:
            return Columns([z, s.sign(joint)], (True, False))
        return Columns([z], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Level and characteristic displacement."""
        name = ctx.model.joints[joint]
        return {
            "level": Value(float(theta[0]), ctx.model.effort_unit(name), (1.0, 0.0)[: len(theta)]),
            "displacement": Value(shape["width"], ctx.model.unit(name), shape_key="width"),
        }

    def brings(
        self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray
    ) -> dict[str, tuple[float, ...]]:
        """The dry friction that the bristle builds up to, where the model has none."""
        return {"coulomb_friction": (1.0,)} if float(ctx.model.model.dof_frictionloss[joint]) <= 0.0 else {}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Bristle state as applied force."""
        return bristle_force(joint, shape["width"], 1, theta, dt)


def bristle_force(
    joint: int, width: float, power: int, theta: np.ndarray, dt: float, beta: float = 1.0
) -> Runtime:
    """Force of a bristle state (``states.bristle``); a second coefficient is Coulomb friction taken back or added."""
    level = float(theta[0])
    flat = float(theta[1]) if len(theta) > 1 else 0.0
    z = 0.0
    last: float | None = None

    def step(state: StepState) -> tuple[float, float]:
        nonlocal z, last
        dq = 0.0 if last is None else state.q[joint] - last
        last = float(state.q[joint])
        if dq != 0.0:
            if power == 1 and beta == 1.0:
                target = 1.0 if dq > 0 else -1.0
                z = target + (z - target) * float(np.exp(-abs(dq) / width))
            else:
                turning = beta * np.sign(z * dq) + 1.0 - beta
                z = float(np.clip(z + dq / width * (1.0 - abs(z) ** power * turning), -1, 1))
        return level * z, flat

    return step


EFFECT = Presliding()
