"""Dry friction: a step at zero speed, flat elsewhere."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value
from s2r_host.gap.motion.quantities import DIRECTION
from s2r_host.gap.motion.session import Session


class CoulombFriction(Effect):
    """tau = Fc sgn(dq)."""

    name = "coulomb_friction"
    equation = "tau = Fc sgn(dq)"
    signature = "a step in the residual at every reversal, equal at all speeds"
    separating_motion = "constant speeds in both directions"
    confusable = ("asymmetric_friction", "stribeck")
    shows_over = DIRECTION

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Direction of motion."""
        return Columns([s.sign(joint)], (float(ctx.model.model.dof_frictionloss[joint]) == 0.0,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Friction level."""
        return {"level": Value(float(theta[0]), ctx.model.effort_unit(ctx.model.joints[joint]), (1.0,))}

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """Stock attribute ``frictionloss``."""
        spec.joint(ctx.model.joints[joint]).frictionloss += float(theta[0])
        return True


EFFECT = CoulombFriction()
