"""Slip and stick between gripper and part: part of the pull is lost while the contact slides."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import PULL
from s2r_host.gap.motion.session import Session, wrench_parts


class ContactSlip(Effect):
    """While |F along| > limit the surplus does not reach the part: tau = -(F - clip(F, ±limit))."""

    name = "contact_slip"
    equation = "transmitted = clip(F_along, ±limit)"
    signature = "a jump when the contact regime changes, in arm and part together"
    separating_motion = "pull the part without the arm; a series of normal forces"
    confusable = ("saturation", "stribeck", "joint_play")
    shows_over = PULL

    def applies(self, ctx: Context, joint: int) -> bool:
        """Needs a wrench on the moved part."""
        return any(wrench_parts(ctx.model, s, joint) is not None for s in ctx.sessions)

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Limits at quantiles of the pull."""
        pulls = [p.along for s in ctx.sessions if (p := wrench_parts(ctx.model, s, joint)) is not None]
        if not pulls:
            return []
        pull = np.abs(np.concatenate(pulls))
        return [{"limit": float(np.quantile(pull, x))} for x in (0.5, 0.7, 0.8, 0.9, 0.95, 0.98)]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Limit on a log scale."""
        return {"limit": ("log", 0.1)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """The surplus, as effort that does not arrive."""
        parts = wrench_parts(ctx.model, s, joint)
        along = np.zeros(len(s.t)) if parts is None else parts.along
        return Columns([along - np.clip(along, -shape["limit"], shape["limit"])], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Pull at which the contact slips, share of the surplus that is lost."""
        unit = ctx.model.effort_unit(ctx.model.joints[joint])
        return {
            "limit": Value(shape["limit"], unit, shape_key="limit"),
            "lost_share": Value(float(theta[0]), "1", (1.0,)),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Clip of the pull."""
        share, limit = float(theta[0]), shape["limit"]

        def step(state: StepState) -> tuple[float, float]:
            pull = float(state.pushed[joint])
            return share * (pull - float(np.clip(pull, -limit, limit))), 0.0

        return step


EFFECT = ContactSlip()
