"""The drive gives less than was asked: a limit, or a limit that falls with speed."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import EFFORT
from s2r_host.gap.motion.session import Session, nominal_friction

# Quantiles of the effort that the motion needs: it ends at the limit, however much is asked for.
NEEDED = (0.9, 0.97, 0.995)
DRIVES, HELD = 1.5, -1e4  # times the model's dry friction that a limit is at least; log odds below it
SHARES = (0.5, 0.65, 0.75, 0.82, 0.88, 0.92, 0.95, 0.975, 0.99, 0.995, 0.998)


class Saturation(Effect):
    """applied = clip(u, ±limit (1 - max(0, sgn(u) dq) / v0))."""

    name = "saturation"
    model_error = {"limit": 0.03, "no_load_speed": 0.05}  # noqa: RUF012
    equation = "applied = clip(u, ±limit (1 - max(0, sgn(u) dq)/v0))"
    signature = "residual only while the effort is high, on one side of a limit"
    separating_motion = "the same motion at growing amplitude"
    confusable = ("armature", "bandwidth", "effort_scale")
    shows_over = EFFORT
    side = "actuator"

    def applies(self, ctx: Context, joint: int) -> bool:
        """Measured effort is already clipped."""
        return any(s.rec.effort == "commanded" for s in ctx.sessions)

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Limits at quantiles of the effort asked for and needed; no-load speeds above the top speed."""
        u = np.concatenate([np.abs(s.drive(joint)) for s in ctx.sessions])
        needed = np.concatenate(
            [
                np.abs(s.load[:, joint] + nominal_friction(ctx.model, s)[:, joint] - s.pushed[:, joint])
                for s in ctx.sessions
            ]
        )
        limits = [float(np.quantile(u, x)) for x in SHARES] + [float(np.quantile(needed, x)) for x in NEEDED]
        limits = [x for x in limits if x > 0]
        top = ctx.top_speed(joint)
        plain = [{"limit": x, "v0": 0.0} for x in limits]
        sloped = [(x, y) for x in limits[::2] for y in (1.3, 2.0, 4.0, 8.0)]
        return plain + [{"limit": x / (1.0 - 0.3 / y), "v0": top * y} for x, y in sloped]

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """A drive that the joint's own dry friction holds would not be there: clipped at it, any effort fits."""
        friction = float(ctx.model.model.dof_frictionloss[joint])
        return 0.0 if shape["limit"] > DRIVES * friction else HELD

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Both on a log scale."""
        return {"limit": ("log", 0.06), "v0": ("log", 0.2)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """What was asked minus what arrived."""
        u = s.drive(joint)
        return Columns([], fixed=u - _clip(u, s.v[:, joint], shape["limit"], shape["v0"]))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Limit and, when it falls with speed, the no-load speed."""
        name = ctx.model.joints[joint]
        found = {"limit": Value(shape["limit"], ctx.model.effort_unit(name), shape_key="limit")}
        if shape["v0"] > 0:
            found["no_load_speed"] = Value(shape["v0"], f"{ctx.model.unit(name)}/s", shape_key="v0")
        return found

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Clip per step."""
        limit, v0 = shape["limit"], shape["v0"]

        def step(state: StepState) -> tuple[float, float]:
            u = float(state.u[joint])
            return u - float(_clip(np.array(u), np.array(state.v[joint]), limit, v0)), 0.0

        return step


def _clip(u: np.ndarray, v: np.ndarray, limit: float, v0: float) -> np.ndarray:
    room = np.full_like(u, limit)
    if v0 > 0:
        room = limit * np.clip(1.0 - np.maximum(0.0, np.sign(u) * v) / v0, 0.0, 1.0)
    return np.clip(u, -room, room)


EFFECT = Saturation()
