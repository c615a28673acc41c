"""Friction that grows with the load the joint carries."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import LOAD_SIZE, WEIGHT_SIZE, Quantity
from s2r_host.gap.motion.session import Session

ALL, WEIGHT, BEHIND_ROTOR, BEHIND_BEARINGS = 0.0, 1.0, 2.0, 3.0  # the load that counts


class LoadDependentFriction(Effect):
    """tau = mu |load| sgn(dq)."""

    name = "load_dependent_friction"
    model_error = {"coefficient": 0.12}  # noqa: RUF012
    equation = "tau = mu |load| sgn(dq)"
    signature = "the step at a reversal grows with gravity and acceleration torque"
    separating_motion = "the same speed at several poses or payloads"
    confusable = ("effort_scale", "coulomb_friction", "payload")
    shows_over = LOAD_SIZE

    def shown_over(self, shape: Shape) -> Quantity:
        """The weight alone, where the motion's own load does not count."""
        return WEIGHT_SIZE if shape.get("load") == WEIGHT else self.shows_over

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """The load has to vary, and to be moved both ways: one way, friction that follows a load is more of it."""
        if not ctx.both_ways(joint):
            return "the joint moves one way: friction by load cannot be told from the load"
        load = np.concatenate([np.abs(s.load[:, joint]) for s in ctx.sessions])
        return None if np.std(load) > 0.1 * np.mean(load) else "the load hardly changes"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Which load counts: all of it, the weight alone, or what passes the gear behind rotor and bearings."""
        inertia, damping = _takes(ctx, joint, BEHIND_BEARINGS)
        loads = [ALL, WEIGHT, *([BEHIND_ROTOR] if inertia else []), *([BEHIND_BEARINGS] if damping else [])]
        return [{"load": load} for load in loads]

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Load times direction."""
        load = static_load(ctx, s) if shape["load"] == WEIGHT else s.load
        inertia, damping = _takes(ctx, joint, shape["load"])
        carried = load[:, joint] - inertia * s.a[:, joint] - damping * s.v[:, joint]
        return Columns([np.abs(carried) * s.sign(joint)], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Friction coefficient."""
        return {"coefficient": Value(float(theta[0]), "1", (1.0,))}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Friction loss written each step."""
        mu = float(theta[0])
        if shape["load"] == WEIGHT:
            return _weight_friction(ctx, joint, mu)
        inertia, damping = _takes(ctx, joint, shape["load"])

        def step(state: StepState) -> tuple[float, float]:
            carried = (
                float(state.load[joint]) - inertia * float(state.a[joint]) - damping * float(state.v[joint])
            )
            return 0.0, mu * abs(carried)

        return step


def static_load(ctx: Context, s: Session) -> np.ndarray:
    """Load of the same poses at rest, shape (time, joint)."""
    if "static" not in s.cache:
        still = np.zeros_like(s.q)
        s.cache["static"] = ctx.model.inverse(s.q, still, still)
    return s.cache["static"]


def _takes(ctx: Context, joint: int, load: float) -> tuple[float, float]:
    """What rotor and bearings take for themselves before the load that counts: by acceleration and by speed."""
    m = ctx.model.model
    inertia = float(m.dof_armature[joint]) if load in (BEHIND_ROTOR, BEHIND_BEARINGS) else 0.0
    return inertia, float(m.dof_damping[joint]) if load == BEHIND_BEARINGS else 0.0


def _weight_friction(ctx: Context, joint: int, mu: float) -> Runtime:
    def step(state: StepState) -> tuple[float, float]:
        still = np.zeros((1, len(state.q)))
        return 0.0, mu * abs(float(ctx.model.inverse(state.q[None], still, still)[0, joint]))

    return step


EFFECT = LoadDependentFriction()
