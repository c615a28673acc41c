"""Play of rails and hinges: a pull beside the centre racks the part and jams it."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import ACROSS, RACKING, Quantity
from s2r_host.gap.motion.session import Session, wrench_parts


class JointPlay(Effect):
    """tau = mu |load across| sgn(dq): extra degrees of freedom show as friction that follows what the bearing takes.

    That is a force across the joint, or the moment of a pull beside the centre, which jams a drawer in its rails.
    """

    name = "joint_play"
    equation = "tau = mu |F_across| sgn(dq), or mu |M_racking| sgn(dq)"
    signature = "resistance grows when the pull is off centre"
    separating_motion = "pull left, centre and right of the handle"
    confusable = ("load_dependent_friction", "contact_slip")
    shows_over = ACROSS
    simulated_by_mean = True

    def applies(self, ctx: Context, joint: int) -> bool:
        """Needs a wrench on the moved part."""
        return any(wrench_parts(ctx.model, s, joint) is not None for s in ctx.sessions)

    def shown_over(self, shape: Shape) -> Quantity:
        """The moment, where that is what jams."""
        return RACKING if shape.get("racked") else self.shows_over

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Friction that follows the force, or the moment."""
        return [{"racked": racked} for racked in (0.0, 1.0) if self._level(ctx, joint, racked) > 0.0]

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """What the bearing takes times direction."""
        return Columns([_load(ctx, s, joint, shape["racked"]) * s.sign(joint)], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Friction per force or moment across."""
        turns = ctx.model.unit(ctx.model.joints[joint]) == "rad"
        units = ("m", "1") if turns else ("1", "1/m")
        return {"coefficient": Value(float(theta[0]), units[int(shape["racked"])], (1.0,))}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """The load across is not part of a one-joint simulation: its mean stands in for it."""
        given = ctx.given or self.given(ctx, joint, shape)
        level = float(theta[0]) * given["level"][0]

        def step(state: StepState) -> tuple[float, float]:
            return 0.0, level

        return step

    def given(self, ctx: Context, joint: int, shape: Shape) -> dict[str, list[float]]:
        """The mean load across."""
        return {"level": [self._level(ctx, joint, shape["racked"])]}

    @staticmethod
    def _level(ctx: Context, joint: int, racked: float) -> float:
        return float(np.mean(np.concatenate([_load(ctx, s, joint, racked) for s in ctx.sessions])))


def _load(ctx: Context, s: Session, joint: int, racked: float) -> np.ndarray:
    """Force across [N] or racking moment [N·m] on the joint's bearing, shape (time,)."""
    parts = wrench_parts(ctx.model, s, joint)
    return np.zeros(len(s.t)) if parts is None else parts.racking if racked else parts.across


EFFECT = JointPlay()
