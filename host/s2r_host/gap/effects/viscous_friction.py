"""Viscous friction: a slope in speed."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value
from s2r_host.gap.motion.session import Session

# Of the dry friction, at the top speed: less than nothing by so much may be an error of the estimate.
DRIVES = 0.1


class ViscousFriction(Effect):
    """tau = b dq."""

    name = "viscous_friction"
    equation = "tau = b dq"
    signature = "residual proportional to speed"
    separating_motion = "constant speeds over a decade, torque sensed at the link"
    confusable = ("effort_scale",)

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Speed."""
        return Columns.of_motion([s.v[:, joint]], (float(ctx.model.model.dof_damping[joint]) == 0.0,))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """What falls with the speed below nothing is no viscous friction."""
        m = ctx.model.model
        least = float(m.dof_damping[joint]) + float(theta[0])
        return -np.inf if drives(ctx, joint, least, float(m.dof_frictionloss[joint])) else 0.0

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Damping coefficient."""
        return {
            "coefficient": Value(float(theta[0]), ctx.model.damping_unit(ctx.model.joints[joint]), (1.0,))
        }

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """Stock attribute ``damping``."""
        add_first(spec.joint(ctx.model.joints[joint]), "damping", float(theta[0]))
        return True


def drives(ctx: Context, joint: int, viscous: float, dry: float) -> bool:
    """Whether a friction slope is so far below zero that it stands for something else.

    Args:
        ctx: Recordings.
        joint: Index.
        viscous: The slope, what the model has included [N·m·s/rad or N·s/m].
        dry: Dry friction, what the model has included [N·m or N].
    """
    top = max((float(np.abs(s.v[:, joint]).max()) for s in ctx.sessions), default=0.0)
    return -viscous * top > DRIVES * max(dry, 0.0)


def add_first(joint: mujoco.MjsJoint, attribute: str, value: float) -> None:
    """Add to an attribute that is a number or a polynomial, lowest order first."""
    old = np.array(getattr(joint, attribute), dtype=float, ndmin=1)
    old[0] += value
    setattr(joint, attribute, old if old.size > 1 else float(old[0]))


EFFECT = ViscousFriction()
