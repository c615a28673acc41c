"""Friction that grows with the load the joint carries."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.session import Session


class LoadDependentFriction(Effect):
    """tau = mu |load| sgn(dq)."""

    name = "load_dependent_friction"
    equation = "tau = mu |load| sgn(dq)"
    signature = "the step at a reversal grows with gravity and acceleration torque"
    separating_motion = "the same speed at several poses or payloads"
    confusable = ("effort_scale", "coulomb_friction", "payload")

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """The load has to vary."""
        load = np.concatenate([np.abs(s.load[:, joint]) for s in ctx.sessions])
        return None if np.std(load) > 0.1 * np.mean(load) else "the load hardly changes"

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Load times direction."""
        return Columns([np.abs(s.load[:, joint]) * s.sign(joint)], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Friction coefficient."""
        return {"coefficient": Value(float(theta[0]), "1", (1.0,))}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Friction loss written each step."""
        mu = float(theta[0])

        def step(state: StepState) -> tuple[float, float]:
            return 0.0, mu * abs(float(state.load[joint]))

        return step


EFFECT = LoadDependentFriction()
