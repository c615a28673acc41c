"""A flexible part: a share of the moved mass hangs on a spring behind the measured joint."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.effects.joint_elasticity import mean_inertia
from s2r_host.gap.motion.quantities import ACCELERATION
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.states import filtered

MORE_THAN_ALL = -60.0  # log odds


class FlexiblePart(Effect):
    """η'' + 2 ζ ω η' + ω² η = -ddq; tau = μ J η''."""

    name = "flexible_part"
    equation = "η'' + 2ζω η' + ω² η = -ddq, tau = μ J η''"
    signature = "ringing after every stop, at one frequency in all poses"
    separating_motion = "pull near and far from the hinge, then stop abruptly"
    confusable = ("joint_elasticity", "backlash")
    shows_over = ACCELERATION

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Frequency and damping ratio."""
        return [{"f": f, "zeta": z} for f in (2.0, 3.0, 4.5, 6.5, 9.5, 14.0, 20.0) for z in (0.01, 0.05, 0.2)]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Both on a log scale."""
        return {"f": ("log", 0.12), "zeta": ("log", 0.5)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """A ringing that is damped within a period is elasticity of another kind."""
        return {"zeta": (0.002, 0.35)}

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """Panels hang on the joints of objects, rarely on one with a motor's inertia."""
        return -4.0 if float(ctx.model.model.dof_armature[joint]) > 0.0 else 0.0

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """No more can hang on the joint than it moves."""
        return MORE_THAN_ALL if float(theta[0]) > 1.0 else 0.0

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Reaction of the hanging share, per unit share of the inertia."""
        w = 2 * np.pi * shape["f"]
        rate = filtered([-1.0, 0.0, 0.0], [1.0, 2 * shape["zeta"] * w, w * w], s.a[:, joint], s.dt)
        return Columns([s.mass[:, joint] * rate], (True,))

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Share of the inertia, frequency, damping ratio."""
        return {
            "inertia_share": Value(float(theta[0]), "1", (1.0,)),
            "frequency": Value(shape["f"], "Hz", shape_key="f"),
            "damping_ratio": Value(shape["zeta"], "1", shape_key="zeta"),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Oscillator state, driven by the last acceleration."""
        w, z = 2 * np.pi * shape["f"], shape["zeta"]
        size = float(theta[0]) * (ctx.given or self.given(ctx, joint, shape))["inertia"][0]
        x = v = 0.0

        def step(state: StepState) -> tuple[float, float]:
            nonlocal x, v
            a = -float(state.a[joint]) - 2 * z * w * v - w * w * x
            v += dt * a
            x += dt * v
            return size * a, 0.0

        return step

    def given(self, ctx: Context, joint: int, shape: Shape) -> dict[str, list[float]]:
        """The inertia that the share is of."""
        return {"inertia": [mean_inertia(ctx, joint)]}


EFFECT = FlexiblePart()
