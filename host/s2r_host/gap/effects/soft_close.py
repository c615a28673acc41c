"""Soft close: a damper over the last part of the travel, in most fittings one-way and with a spring that pulls in."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import POSITION
from s2r_host.gap.motion.session import Session

BOTH_WAYS = -1.0  # log odds
DEEP = 0.5  # of the zone


class SoftClose(Effect):
    """tau = b dq while the joint is beyond q0 and still going there, less a pull towards the end.

    Cheap dampers brake both ways; the spring that pulls the part in is pre-stressed, so its force is constant.
    """

    name = "soft_close"
    model_error = {"damping": 0.04}  # noqa: RUF012
    equation = "tau = b dq - side F for side (q - q0) > 0; b = 0 for side dq < 0 where it is one-way"
    signature = "proportional to speed, near one end, in most fittings in one direction"
    separating_motion = "open and close at two speeds"
    confusable = ("soft_end_stop", "viscous_friction", "asymmetric_friction")
    shows_over = POSITION
    part_is = "the brake of the deeper half"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Edges over the outer 60 % of the travel, both ends; one-way and both ways."""
        low, high = ctx.span(joint)
        travel = high - low
        share = (0.05, 0.1, 0.15, 0.2, 0.27, 0.35, 0.45, 0.6)
        ends = [(low + travel * x, -1.0) for x in share] + [(high - travel * x, 1.0) for x in share]
        return [
            {"q0": q0, "side": side, "ramp": travel * r, "back": back}
            for q0, side in ends
            for r in (0.01, 0.06)
            for back in (0.0, 1.0)
        ]

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """Most dampers of fittings let the part go freely on its way out."""
        return BOTH_WAYS * shape["back"]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Edge, linear."""
        low, high = ctx.span(joint)
        return {"q0": ("linear", (high - low) * 0.02), "ramp": ("log", 0.4)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """A ramp between a sharp edge and a fifth of the travel."""
        low, high = ctx.span(joint)
        return {"ramp": (0.005 * (high - low), 0.2 * (high - low))}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Speed inside the zone, only on the way in where it is one-way; the pull inside the zone."""
        pulled = -shape["side"] * _inside(s, joint, shape)
        return Columns([_braked(s, joint, shape), pulled], (True, True))

    def part(
        self, ctx: Context, s: Session, joint: int, shape: Shape, theta: np.ndarray
    ) -> np.ndarray | None:
        """The brake deep in the zone; what is caught at its edge loses speed there and nowhere else."""
        low, high = ctx.span(joint)
        side = shape["side"]
        deepest = side * ((high if side > 0 else low) - shape["q0"])
        deep = side * (s.q[:, joint] - shape["q0"]) > DEEP * deepest
        return theta[0] * _braked(s, joint, shape) * deep

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Where the damper begins, its damping once it is fully in, and the force of the spring that pulls in."""
        name = ctx.model.joints[joint]
        unit = ctx.model.unit(name)
        return {
            "position": Value(shape["q0"], unit, shape_key="q0", error=0.12 * shape["ramp"]),
            "damping": Value(float(theta[0]), ctx.model.damping_unit(name), (1.0, 0.0)),
            "pull": Value(float(theta[1]), ctx.model.effort_unit(name), (0.0, 1.0)),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Damper and spring."""
        b, pull, q0, side, ramp = float(theta[0]), float(theta[1]), shape["q0"], shape["side"], shape["ramp"]
        both = shape["back"] > 0

        def step(state: StepState) -> tuple[float, float]:
            v = float(state.v[joint])
            inside = float(_zone(np.asarray(side * (state.q[joint] - q0)), ramp))
            return inside * ((b * v if both or side * v > 0 else 0.0) - side * pull), 0.0

        return step


def _braked(s: Session, joint: int, shape: Shape) -> np.ndarray:
    """Effort per unit of damping."""
    v = s.v[:, joint]
    return v * _inside(s, joint, shape) * ((shape["side"] * v > 0) | (shape["back"] > 0))


def _inside(s: Session, joint: int, shape: Shape) -> np.ndarray:
    """How far in the zone each row is, 0 to 1."""
    return _zone(shape["side"] * (s.q[:, joint] - shape["q0"]), shape["ramp"])


def _zone(depth: np.ndarray, ramp: float) -> np.ndarray:
    return np.clip(depth / (ramp + 1e-12), 0.0, 1.0)


EFFECT = SoftClose()
