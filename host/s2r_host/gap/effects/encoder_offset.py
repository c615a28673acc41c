"""The encoder's zero is off: gravity is felt at another angle than recorded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value, turned
from s2r_host.gap.motion.quantities import POSITION
from s2r_host.gap.motion.session import Session

STEP, BEND_STEP = 1e-3, 1e-2
ZERO = 0.15  # rad to which a zero is set: half a tooth of a spline of 25 is 0.13


class EncoderOffset(Effect):
    """true q = recorded q + offset."""

    name = "encoder_offset"
    equation = "q = q_recorded + offset"
    signature = "phase error of the gravity torque"
    separating_motion = "an absolute reference, or a second joint moved by 90 degrees"
    confusable = ("gravity_tilt",)
    shows_over = POSITION
    side = "sensor"

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Derivative of the load by this joint's position, on all joints."""
        return Columns.of_motion([load_slope(ctx, s, joint)])

    def applies(self, ctx: Context, joint: int) -> bool:
        """The load must depend on the position."""
        s = ctx.sessions[0]
        column = self.columns(ctx, s, joint, {}).linear[0]
        return float(np.max(np.abs(column))) > 1e-6 * max(1.0, float(np.max(np.abs(s.load))))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """A zero may be off by a tooth."""
        rotary = ctx.model.unit(ctx.model.joints[joint]) == "rad"
        return turned(float(theta[0]), ZERO) if rotary else 0.0

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Recorded minus true position."""
        return {"offset": Value(-float(theta[0]), ctx.model.unit(ctx.model.joints[joint]), (-1.0,))}

    def sense(
        self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray
    ) -> Callable[[float], float] | None:
        """Recorded = true - offset."""
        offset = float(theta[0])
        return lambda q: q - offset


def load_slope(ctx: Context, s: Session, joint: int) -> np.ndarray:
    """Change of the load with the position of a joint along the recorded motion, shape (time, joint)."""
    key = ("offset", joint)
    if key not in s.cache:
        q = s.q.copy()
        q[:, joint] += STEP
        s.cache[key] = (ctx.model.inverse(q, s.v, s.a) - s.load) / STEP
    return s.cache[key]


def load_bend(ctx: Context, s: Session, joint: int) -> np.ndarray:
    """Change of that slope with the position of the joint, on the joint itself, shape (time,)."""
    key = ("bend", joint)
    if key not in s.cache:
        sides = []
        for step in (-BEND_STEP, BEND_STEP):
            q = s.q.copy()
            q[:, joint] += step
            sides.append(ctx.model.inverse(q, s.v, s.a))
        s.cache[key] = ((sides[0] + sides[1] - 2.0 * s.load) / BEND_STEP**2)[:, joint]
    return s.cache[key]


EFFECT = EncoderOffset()
