"""Friction that changed between sessions: one factor per recording."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value
from s2r_host.gap.motion.quantities import RECORDING
from s2r_host.gap.motion.session import Session


class SessionFriction(Effect):
    """tau = dF_session sgn(dq)."""

    name = "session_friction"
    model_error = {"factor": 0.015}  # noqa: RUF012
    equation = "tau = dF_session sgn(dq)"
    signature = "the same regressor with another coefficient in each recording"
    separating_motion = "the same motion at the start of each session"
    confusable = ("effort_scale", "thermal_drift")
    shows_over = RECORDING

    def applies(self, ctx: Context, joint: int) -> bool:
        """Needs two sessions among the fitted recordings."""
        return len(self._labels(ctx)) > 1

    def _labels(self, ctx: Context) -> list[str]:
        return sorted({s.rec.session for s in ctx.sessions})

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Direction of motion, switched on in one session each; the first session is the reference."""
        labels = self._labels(ctx)
        linear = [s.sign(joint) * (s.rec.session == label) for label in labels[1:]]
        positive = [False] * len(linear)
        if not ctx.model.model.dof_frictionloss[joint]:
            linear.append(s.sign(joint))
            positive.append(True)
        return Columns(linear, tuple(positive))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Difference to the first session, per session."""
        unit = ctx.model.effort_unit(ctx.model.joints[joint])
        found = {}
        for i, label in enumerate(self._labels(ctx)[1:]):
            gradient = [0.0] * len(theta)
            gradient[i] = 1.0
            found[f"change_{label}"] = Value(float(theta[i]), unit, tuple(gradient))
        return found


EFFECT = SessionFriction()
