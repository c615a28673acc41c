"""Play of rails and hinges: a pull beside the centre racks the part and jams it."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.session import Session, wrench_parts


class JointPlay(Effect):
    """tau = mu |F across| sgn(dq): extra degrees of freedom show as friction that follows the sideways load."""

    name = "joint_play"
    equation = "tau = mu |F_across| sgn(dq)"
    signature = "resistance grows when the pull is off centre"
    separating_motion = "pull left, centre and right of the handle"
    confusable = ("load_dependent_friction", "contact_slip")

    def applies(self, ctx: Context, joint: int) -> bool:
        """Needs a wrench on the moved part."""
        return any(wrench_parts(ctx.model, s, joint) is not None for s in ctx.sessions)

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Sideways force times direction."""
        parts = wrench_parts(ctx.model, s, joint)
        across = np.zeros(len(s.t)) if parts is None else parts[1]
        return Columns([across * s.sign(joint)], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Friction per sideways force."""
        unit = "m" if ctx.model.unit(ctx.model.joints[joint]) == "rad" else "1"
        return {"coefficient": Value(float(theta[0]), unit, (1.0,))}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """The sideways load is not part of a one-joint simulation: its mean stands in for it."""
        loads = [p[1] for s in ctx.sessions if (p := wrench_parts(ctx.model, s, joint)) is not None]
        level = float(theta[0]) * float(np.mean(np.concatenate(loads))) if loads else 0.0

        def step(state: StepState) -> tuple[float, float]:
            return 0.0, level

        return step


EFFECT = JointPlay()
