"""Stribeck friction: more at small speed, stick-slip."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.session import Session


class Stribeck(Effect):
    """tau = (Fc + Fs exp(-(dq/vs)²)) sgn(dq)."""

    name = "stribeck"
    model_error = {"static_excess": 0.18, "speed": 0.1}  # noqa: RUF012
    explained_least = 0.5  # when a joint breaks away is chaotic: no model follows each stick and slip
    equation = "tau = (Fc + Fs exp(-(dq/vs)²)) sgn(dq)"
    signature = "a hump in the residual at small speeds"
    separating_motion = "very slow ramps in both directions, then faster ones"
    confusable = ("presliding", "load_dependent_friction", "coulomb_friction")
    contains = ("coulomb_friction",)

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Stribeck speeds from the velocity noise up to half the top speed."""
        top = ctx.top_speed(joint)
        low, high = self.bounds(ctx, joint)["vs"]
        seeds = [
            {"vs": top * x}
            for x in (0.012, 0.02, 0.035, 0.06, 0.1, 0.17, 0.28, 0.45)
            if low <= top * x <= high
        ]
        return seeds or [{"vs": low}]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Speed on a log scale."""
        return {"vs": ("log", 0.3)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """Below a few times the velocity noise a hump is only the edge of the sign function."""
        least = 5.0 * max(float(s.v_eps[joint]) for s in ctx.sessions)
        return {"vs": (max(least, 0.012 * ctx.top_speed(joint)), ctx.top_speed(joint))}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Hump and flat part; the flat part may shrink where the model has one."""
        sign = s.sign(joint)
        known = float(ctx.model.model.dof_frictionloss[joint]) > 0.0
        hump = sign * np.exp(-((s.v[:, joint] / shape["vs"]) ** 2))
        return Columns([hump] if known else [hump, sign], (True,) if known else (True, True))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Extra static level, Stribeck speed, flat level."""
        name = ctx.model.joints[joint]
        unit = ctx.model.effort_unit(name)
        found = {
            "static_excess": Value(float(theta[0]), unit, (1.0, 0.0)[: len(theta)]),
            "speed": Value(shape["vs"], f"{ctx.model.unit(name)}/s", shape_key="vs"),
        }
        if len(theta) > 1:
            found["level"] = Value(float(theta[1]), unit, (0.0, 1.0))
        return found

    def brings(
        self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray
    ) -> dict[str, tuple[float, ...]]:
        """The dry friction of fast motion, where the model has none."""
        return {"coulomb_friction": (0.0, 1.0)} if len(theta) > 1 else {}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Friction loss written each step."""
        static, speed = float(theta[0]), shape["vs"]
        flat = float(theta[1]) if len(theta) > 1 else 0.0

        def step(state: StepState) -> tuple[float, float]:
            return 0.0, flat + static * float(np.exp(-((state.v[joint] / speed) ** 2)))

        return step


EFFECT = Stribeck()
