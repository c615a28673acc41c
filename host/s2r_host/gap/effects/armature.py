"""Rotor inertia seen through the gear."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value, small_is_odd
from s2r_host.gap.motion.session import Session


class Armature(Effect):
    """tau = J ddq."""

    name = "armature"
    equation = "tau = J ddq"
    signature = "residual proportional to the joint's own acceleration, in all poses"
    separating_motion = "fast sines in two poses of the other joints"
    confusable = ("payload", "effort_scale")

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Acceleration."""
        return Columns.of_motion([s.a[:, joint]], (True,))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Against a wrong number of the nominal model."""
        return small_is_odd(float(theta[0]) / max(float(np.mean(ctx.sessions[0].mass[:, joint])), 1e-12))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Reflected inertia."""
        unit = "kg·m²" if ctx.model.unit(ctx.model.joints[joint]) == "rad" else "kg"
        return {"inertia": Value(float(theta[0]), unit, (1.0,))}

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """Stock attribute ``armature``."""
        spec.joint(ctx.model.joints[joint]).armature += float(theta[0])
        return True


EFFECT = Armature()
