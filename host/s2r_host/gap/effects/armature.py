"""Rotor inertia seen through the gear."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import IMPOSSIBLE, Columns, Context, Effect, Shape, Value, small_is_odd
from s2r_host.gap.motion.quantities import ACCELERATION
from s2r_host.gap.motion.session import Session


class Armature(Effect):
    """tau = J ddq."""

    name = "armature"
    equation = "tau = J ddq"
    signature = "residual proportional to the joint's own acceleration, in all poses"
    separating_motion = "fast sines in two poses of the other joints"
    confusable = ("payload", "effort_scale")
    shows_over = ACCELERATION
    foreign_is = "an inertia that changes with the joint's position"

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Acceleration."""
        return Columns.of_motion([s.a[:, joint]], (True,))

    def foreign(
        self, ctx: Context, s: Session, joint: int, shape: Shape, theta: np.ndarray
    ) -> np.ndarray | None:
        """M ddq + M' dq²/2 for M = J x and J (2x² - 1), x the position from -1 to 1 over the range that was seen."""
        low, high = ctx.span(joint)
        half = (high - low) / 2.0
        if not half > 0.0:
            return None
        q, v, a = s.q[:, joint], s.v[:, joint], s.a[:, joint]
        x = (q - low) / half - 1.0
        rising = x * a + v**2 / (2.0 * half)
        bent = (2.0 * x**2 - 1.0) * a + 2.0 * x * v**2 / half
        return theta[0] * np.stack([rising, bent], axis=1)

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """An acceleration that is noise tells no inertia."""
        return 0.0 if ctx.accelerates(joint) else IMPOSSIBLE

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Against a wrong number of the nominal model."""
        return small_is_odd(float(theta[0]) / max(float(np.mean(ctx.sessions[0].mass[:, joint])), 1e-12))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Reflected inertia."""
        return {"inertia": Value(float(theta[0]), ctx.model.inertia_unit(ctx.model.joints[joint]), (1.0,))}

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """Stock attribute ``armature``."""
        spec.joint(ctx.model.joints[joint]).armature += float(theta[0])
        return True


EFFECT = Armature()
