"""Torque constant or gear ratio wrong: the joint gets a fixed share of the recorded effort."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import IMPOSSIBLE, Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import EFFORT
from s2r_host.gap.motion.session import Session

FARTHEST = 2.0  # factor


class EffortScale(Effect):
    """applied = scale * recorded."""

    name = "effort_scale"
    equation = "applied = scale u"
    signature = "residual proportional to the effort itself on one joint"
    separating_motion = "the same motion with a known added mass"
    confusable = ("payload", "armature", "viscous_friction")
    shows_over = EFFORT
    side = "actuator"

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """The effort the model needs of its drive. The recorded effort would explain its own noise."""
        friction = float(ctx.model.model.dof_frictionloss[joint]) * s.sign(joint)
        needed = s.load[:, joint] - s.pushed[:, joint]
        return Columns([needed + friction], smooth=(s.load[:, joint],))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Against what no gear or torque constant is off by; some per cent are usual, which data sheets allow."""
        factor = 1.0 + float(theta[0])
        return 0.0 if 1.0 / FARTHEST < factor < FARTHEST else IMPOSSIBLE

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Share of the recorded effort that arrives."""
        factor = 1.0 + float(theta[0])
        return {"scale": Value(1.0 / factor, "1", (-1.0 / factor**2,))}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Takes the missing share away."""
        share = 1.0 - 1.0 / (1.0 + float(theta[0]))

        def step(state: StepState) -> tuple[float, float]:
            return share * float(state.u[joint]), 0.0

        return step


EFFECT = EffortScale()
