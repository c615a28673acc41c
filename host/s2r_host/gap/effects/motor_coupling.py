"""Motors that turn together: the effort of one joint follows another joint's motion."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import OTHER_ACCELERATION
from s2r_host.gap.motion.session import Session


class MotorCoupling(Effect):
    """tau_i = Jc ddq_j + bc dq_j, and the same from i to j where the gears act both ways (``mutual``).

    A motor j that joint i turns along, by c of its own angle, is felt in motions of joint i alone as well (``own``):
    from T = J (dq_j + c dq_i)² / 2, tau_i has J c ddq_j + J c² ddq_i and tau_j has J c ddq_i.
    """

    name = "motor_coupling"
    equation = "tau_i = Jc ddq_j + bc dq_j"
    signature = "residual of one joint follows speed and acceleration of another"
    separating_motion = "move one motor at a time"
    confusable = ("payload", "armature")
    shows_over = OTHER_ACCELERATION

    def applies(self, ctx: Context, joint: int) -> bool:
        """Needs a second joint."""
        return len(ctx.model.joints) > 1

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Each other joint; what acts both ways belongs to the later one of the two."""
        others = [i for i in range(len(ctx.model.joints)) if i != joint and ctx.top_speed(i) > 1e-3]
        one_way = [{"other": float(i), "mutual": 0.0} for i in others]
        both_ways = [{"other": float(i), "mutual": 1.0} for i in others if i < joint]
        turned_along = [{"other": float(i), "mutual": 1.0, "own": 1.0} for i in others if abs(i - joint) == 1]
        return one_way + both_ways + turned_along

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Acceleration and speed of the other joint; of the joint itself, where it turns the other's motor along."""
        other = int(shape["other"])
        if not shape["mutual"]:
            return Columns.of_motion([s.a[:, other], s.v[:, other]])
        both = []
        for x in (s.a, s.v):
            crossed = np.zeros_like(x)
            crossed[:, joint], crossed[:, other] = x[:, other], x[:, joint]
            both.append(crossed)
        if not shape.get("own"):
            return Columns.of_motion(both)
        alone = [np.zeros_like(s.a), np.zeros_like(s.v)]
        alone[0][:, joint], alone[1][:, joint] = s.a[:, joint], s.v[:, joint]
        return Columns.of_motion([*both, *alone], (False, False, True, True))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Coupling inertia and damping, what the joint feels of itself; ``other`` counts joints from zero."""
        model = ctx.model
        own, other = model.joints[joint], model.joints[int(shape["other"])]
        names = [("inertia", model.inertia_unit(own, other)), ("damping", model.damping_unit(own, other))]
        if shape.get("own"):
            names += [("own_inertia", model.inertia_unit(own)), ("own_damping", model.damping_unit(own))]
        gradients = np.eye(len(names))
        found = {
            name: Value(float(x), unit, tuple(map(float, row)))
            for (name, unit), x, row in zip(names, theta, gradients, strict=True)
        }
        return found | {"other": Value(shape["other"], "joint index")}

    def mirror(self, joint: int, shape: Shape) -> tuple[int, dict[str, float]] | None:
        """What the other joint feels of this one."""
        if not shape["mutual"]:
            return None
        return int(shape["other"]), {"other": float(joint), "mutual": 0.0}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Force from the last accelerations."""
        other, (inertia, damping) = int(shape["other"]), map(float, theta[:2])
        own_inertia, own_damping = map(float, theta[2:]) if shape.get("own") else (0.0, 0.0)

        def step(state: StepState) -> tuple[float, float]:
            crossed = inertia * float(state.a[other]) + damping * float(state.v[other])
            return crossed + own_inertia * float(state.a[joint]) + own_damping * float(state.v[joint]), 0.0

        return step


EFFECT = MotorCoupling()
