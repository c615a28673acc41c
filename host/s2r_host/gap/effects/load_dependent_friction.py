"""Friction that grows with the load the joint carries."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.session import Session


class LoadDependentFriction(Effect):
    """tau = mu |load| sgn(dq)."""

    name = "load_dependent_friction"
    model_error = {"coefficient": 0.12}  # noqa: RUF012
    equation = "tau = mu |load| sgn(dq)"
    signature = "the step at a reversal grows with gravity and acceleration torque"
    separating_motion = "the same speed at several poses or payloads"
    confusable = ("effort_scale", "coulomb_friction", "payload")

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """The load has to vary, and to be moved both ways: one way, friction that follows a load is more of it."""
        if not ctx.both_ways(joint):
            return "the joint moves one way: friction by load cannot be told from the load"
        load = np.concatenate([np.abs(s.load[:, joint]) for s in ctx.sessions])
        return None if np.std(load) > 0.1 * np.mean(load) else "the load hardly changes"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Which load counts: all of it, or only the weight."""
        return [{"weight_only": 0.0}, {"weight_only": 1.0}]

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Load times direction."""
        load = static_load(ctx, s)[:, joint] if shape["weight_only"] else s.load[:, joint]
        return Columns([np.abs(load) * s.sign(joint)], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Friction coefficient."""
        return {"coefficient": Value(float(theta[0]), "1", (1.0,))}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Friction loss written each step."""
        mu = float(theta[0])
        if shape["weight_only"]:
            return _weight_friction(ctx, joint, mu)

        def step(state: StepState) -> tuple[float, float]:
            return 0.0, mu * abs(float(state.load[joint]))

        return step


def static_load(ctx: Context, s: Session) -> np.ndarray:
    """Load of the same poses at rest, shape (time, joint)."""
    if "static" not in s.cache:
        still = np.zeros_like(s.q)
        s.cache["static"] = ctx.model.inverse(s.q, still, still)
    return s.cache["static"]


def _weight_friction(ctx: Context, joint: int, mu: float) -> Runtime:
    def step(state: StepState) -> tuple[float, float]:
        still = np.zeros((1, len(state.q)))
        return 0.0, mu * abs(float(ctx.model.inverse(state.q[None], still, still)[0, joint]))

    return step


EFFECT = LoadDependentFriction()
