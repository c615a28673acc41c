"""Motors that turn together: the effort of one joint follows another joint's motion."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.session import Session


class MotorCoupling(Effect):
    """tau_i = Jc ddq_j + bc dq_j, and the same from i to j where the gears act both ways (``mutual``)."""

    name = "motor_coupling"
    equation = "tau_i = Jc ddq_j + bc dq_j"
    signature = "residual of one joint follows speed and acceleration of another"
    separating_motion = "move one motor at a time"
    confusable = ("payload", "armature")

    def applies(self, ctx: Context, joint: int) -> bool:
        """Needs a second joint."""
        return len(ctx.model.joints) > 1

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Each other joint; what acts both ways belongs to the later one of the two."""
        others = [i for i in range(len(ctx.model.joints)) if i != joint and ctx.top_speed(i) > 1e-3]
        one_way = [{"other": float(i), "mutual": 0.0} for i in others]
        return one_way + [{"other": float(i), "mutual": 1.0} for i in others if i < joint]

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Acceleration and speed of the other joint."""
        other = int(shape["other"])
        if not shape["mutual"]:
            return Columns.of_motion([s.a[:, other], s.v[:, other]])
        both = []
        for x in (s.a, s.v):
            crossed = np.zeros_like(x)
            crossed[:, joint], crossed[:, other] = x[:, other], x[:, joint]
            both.append(crossed)
        return Columns.of_motion(both)

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Coupling inertia and damping; ``other`` counts joints from zero."""
        return {
            "inertia": Value(float(theta[0]), "kg·m²", (1.0, 0.0)),
            "damping": Value(float(theta[1]), "N·m·s/rad", (0.0, 1.0)),
            "other": Value(shape["other"], "joint index"),
        }

    def mirror(self, joint: int, shape: Shape) -> tuple[int, dict[str, float]] | None:
        """What the other joint feels of this one."""
        if not shape["mutual"]:
            return None
        return int(shape["other"]), {"other": float(joint), "mutual": 0.0}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Force from the other joint's last acceleration."""
        other, inertia, damping = int(shape["other"]), float(theta[0]), float(theta[1])

        def step(state: StepState) -> tuple[float, float]:
            return inertia * float(state.a[other]) + damping * float(state.v[other]), 0.0

        return step


EFFECT = MotorCoupling()
