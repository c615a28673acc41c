"""Spring return, counterbalance, door closer: monotone in position, no loop."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value, as_written
from s2r_host.gap.effects.viscous_friction import add_first
from s2r_host.gap.motion.quantities import POSITION
from s2r_host.gap.motion.session import Session

EDGE, AMID = 0.1, -8.0  # share of the travel, log odds
STEADY = 1e-4  # of a pull over the travel: a spring that changes by no more is a steady pull


class SpringReturn(Effect):
    """tau = k (q - q0)."""

    name = "spring_return"
    equation = "tau = k (q - q0)"
    signature = "monotone in position, the same in both directions"
    separating_motion = "slow motion both ways in another pose of the other joints"
    confusable = ("cable_spring", "payload", "gravity_tilt")
    shows_over = POSITION

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Position and a constant."""
        return Columns.of_motion([s.q[:, joint], np.ones(len(s.t))], (True, False))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """What returns a joint pulls one way over its whole travel; a rest amid the travel is a cable's or hose's."""
        low, high = ctx.span(joint)
        edge = EDGE * (high - low)
        rest = -float(theta[1]) / float(theta[0]) if theta[0] > 0 else np.inf
        return AMID if low + edge < rest < high - edge else 0.0

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Stiffness and rest position."""
        return spring_values(ctx, joint, theta)

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """Stock attributes ``stiffness`` and ``springref``; a steady pull is a weak spring with its rest far away."""
        k, c = float(theta[0]), float(theta[1])
        low, high = ctx.span(joint)
        k = max(k, STEADY * abs(c) / max(high - low, 1e-9))
        return add_spring(ctx, spec, joint, k, -c / k) if k > 0.0 else True


def spring_values(ctx: Context, joint: int, theta: np.ndarray) -> dict[str, Value]:
    """Stiffness and rest position from coefficients (k, -k q0); the pull itself where nothing of it is elastic."""
    name = ctx.model.joints[joint]
    unit, effort = ctx.model.unit(name), ctx.model.effort_unit(name)
    k, c = float(theta[0]), float(theta[1])
    extra = (0.0,) * (len(theta) - 2)
    found = {"stiffness": Value(k, f"{effort}/{unit}", (1.0, 0.0, *extra))}
    if abs(k) > 1e-9:
        found["rest"] = Value(-c / k, unit, (c / k**2, -1.0 / k, *extra))
    else:
        found["pull"] = Value(-c, effort, (0.0, -1.0, *extra))
    return found


def add_spring(ctx: Context, spec: mujoco.MjSpec, joint: int, k: float, rest: float) -> bool:
    """Merge a spring with the one the model has (two springs in parallel are one)."""
    target = spec.joint(ctx.model.joints[joint])
    old = float(ctx.model.model.jnt_stiffness[joint])
    old_rest = float(ctx.model.model.qpos_spring[ctx.model.model.jnt_qposadr[joint]])
    target.springref = as_written(spec, target, (old * old_rest + k * rest) / (old + k))
    add_first(target, "stiffness", k)
    return True


EFFECT = SpringReturn()
