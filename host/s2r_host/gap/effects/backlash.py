"""Backlash: a dead zone between motor and link."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Shape, Value
from s2r_host.gap.effects.joint_elasticity import mean_inertia, motor_shares, second_joint, transmitted
from s2r_host.gap.session import Session

LOG_STEP = 0.06


class Backlash(Effect):
    """T = -k dz(δ, w): nothing is transmitted while |q_link - q_motor| < w; q is read at the motor."""

    name = "backlash"
    equation = "T = k dz(q_motor - q_link, w)"
    signature = "after each reversal of the load the effort vanishes for a constant travel, then an impact"
    separating_motion = "reversals with and without preload"
    confusable = ("presliding", "hysteresis", "joint_elasticity")
    explained_least = 0.5  # impacts are chaotic: no model follows each of them

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """The load has to change sign, or the gap is never crossed."""
        load = np.concatenate([s.load[:, joint] for s in ctx.sessions])
        both = min(np.mean(load > 0), np.mean(load < 0))
        return None if both > 0.005 else "the load never changes sign: the gap is never crossed"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Half widths from the encoder step to 6 % of the travel."""
        low, high = ctx.span(joint)
        widths = (high - low) * np.geomspace(0.0006, 0.05, 24)
        return [
            {"w": float(w), "motor": m, "f": f, "zeta": z}
            for m in motor_shares(ctx, joint)
            for w in widths
            for f in (13.0, 24.0)
            for z in (0.4,)
        ]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Width on a log scale, motor share linear."""
        return {"w": ("log", 0.24), "motor": ("linear", 0.1), "f": ("log", 0.24), "zeta": ("log", 0.48)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Motor inertia plus transmitted effort, minus the rigid load."""
        store: dict[tuple, np.ndarray] = s.cache.setdefault(("backlash", joint), {})
        wanted = node(shape)
        if wanted not in store:
            near = [
                tuple(wanted[i] + (i == k) * d for i in range(4))
                for k in range(4)
                for d in (-8, -4, -2, -1, 1, 2, 4, 8)
            ]
            seeds = [node(x) for x in self.shapes(ctx, joint)] if not store else near
            batch = [x for x in dict.fromkeys([*seeds, wanted]) if x not in store and 0 <= x[1] <= 18]
            values = np.array([denode(x) for x in batch])
            T = transmitted(ctx, s, joint, values[:, [2, 3, 1]], values[:, 0])
            for i, name in enumerate(batch):
                store[name] = T[:, i]
        return Columns([], fixed=store[wanted])

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Half width and motor inertia."""
        name = ctx.model.joints[joint]
        J = mean_inertia(ctx, joint)
        return {
            "half_width": Value(shape["w"], ctx.model.unit(name), shape_key="w"),
            "motor_inertia": Value(J * shape["motor"], "kg·m²", shape_key="motor", scale=J),
        }

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """A second, coincident joint with a range of ±w."""
        flex = second_joint(ctx, spec, joint, shape["motor"] * mean_inertia(ctx, joint))
        flex.range = [-shape["w"], shape["w"]]
        flex.limited = 1
        flex.solref_limit = [0.004, 0.7]
        return True


def node(shape: Shape) -> tuple[int, int, int, int]:
    """Nearest node of the grid on which the hidden link is integrated: 6 % steps, 5 % in motor share."""
    motor = round(float(np.clip(shape["motor"], 0.0, 0.9)) / 0.05)
    w, f, zeta = (round(float(np.log(shape[k])) / LOG_STEP) for k in ("w", "f", "zeta"))
    return w, motor, f, zeta


def denode(x: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Half width, motor share, contact frequency, contact damping of a node."""
    w, f, zeta = (float(np.exp(LOG_STEP * k)) for k in (x[0], x[2], x[3]))
    return w, 0.05 * x[1], f, zeta


EFFECT = Backlash()
