"""Cable or hose: a spring with a loop from bending friction."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.effects.presliding import bristle_force
from s2r_host.gap.effects.spring_return import spring_values
from s2r_host.gap.motion.quantities import POSITION
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.states import bristle

HARDENS = 1.0
# Spring over the travel in heights of the loop; log odds, more than what laws of loops differ by.
SLACK, NO_SPRING = 0.1, -60.0


class CableSpring(Effect):
    """tau = k (q - q0) + k3 (q - q0)³ + Fb z."""

    name = "cable_spring"
    model_error = {"stiffness": 0.6}  # noqa: RUF012
    equation = "tau = k (q - q0) + k3 (q - q0)³ + Fb z, dz/dq = (1 - z sgn dq)/zs"
    signature = "slow function of position, steeper towards its ends, with a loop at reversals"
    separating_motion = "unplug the cable, or repeat at another wrist angle"
    confusable = ("spring_return", "payload", "hysteresis")
    shows_over = POSITION
    contains = ("spring_return",)

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Loop widths as shares of the motion; straight springs and hardening ones."""
        low, high = ctx.span(joint)
        widths = [(high - low) * x for x in (0.02, 0.05, 0.12, 0.3)]
        return [{"width": w, "hardens": h} for w in widths for h in (0.0, HARDENS)]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Loop width on a log scale."""
        return {"width": ("log", 0.35)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Position, constant, loop; square and cube of the position where the spring hardens."""
        z = bristle(s, joint, np.array([shape["width"]]))[:, 0]
        q = s.q[:, joint]
        found, positive = [q, np.ones(len(s.t)), z], (True, False, True)
        if not shape["hardens"]:
            return Columns(found, positive)
        x = q - self._middle(ctx, joint)
        return Columns([*found, x**2, x**3], (*positive, False, True))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """What bends returns: a loop whose spring vanishes beside it is hysteresis and no cable."""
        q = np.linspace(*ctx.span(joint), 50)
        x = q - self._middle(ctx, joint)
        square, cube = (theta[3], theta[4]) if shape["hardens"] else (0.0, 0.0)
        spring = float(np.ptp(theta[0] * q + square * x**2 + cube * x**3))
        return NO_SPRING if spring < SLACK * 2.0 * float(theta[2]) else 0.0

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Spring and loop height."""
        found = (
            spring_values(ctx, joint, theta) if not shape["hardens"] else self._hardening(ctx, joint, theta)
        )
        unit = ctx.model.effort_unit(ctx.model.joints[joint])
        extra = (0.0,) * (len(theta) - 3)
        found["bending_friction"] = Value(float(theta[2]), unit, (0.0, 0.0, 1.0, *extra))
        return found

    def _hardening(self, ctx: Context, joint: int, theta: np.ndarray) -> dict[str, Value]:
        """Rest and stiffness there: where the curve rises through zero nearest the middle of the travel.

        Where it falls through zero the cable pushes away.
        """
        name = ctx.model.joints[joint]
        unit, effort = ctx.model.unit(name), ctx.model.effort_unit(name)
        middle = self._middle(ctx, joint)

        def at_rest(c: np.ndarray) -> np.ndarray:
            curve = np.polynomial.Polynomial([c[0] * middle + c[1], c[0], c[3], c[4]])
            roots = curve.roots()
            real = roots[np.abs(roots.imag) < 1e-9].real
            rests = real[curve.deriv()(real) >= 0.0]
            real = rests if rests.size else real
            x = float(real[np.argmin(np.abs(real))]) if real.size else 0.0
            return np.array([middle + x, float(curve.deriv()(x))])

        here = at_rest(theta)
        steps = 1e-4 * np.abs(theta) + 1e-9
        slopes = np.stack([(at_rest(theta + d) - here) / d.sum() for d in np.diag(steps)])
        return {
            "stiffness": Value(float(here[1]), f"{effort}/{unit}", tuple(map(float, slopes[:, 1]))),
            "rest": Value(float(here[0]), unit, tuple(map(float, slopes[:, 0]))),
        }

    @staticmethod
    def _middle(ctx: Context, joint: int) -> float:
        return 0.5 * sum(ctx.span(joint))

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Spring and loop as force."""
        loop = bristle_force(joint, shape["width"], 1, theta[2:3], dt)
        k, c = float(theta[0]), float(theta[1])
        middle = (ctx.given or self.given(ctx, joint, shape))["middle"][0]
        square, cube = (float(theta[3]), float(theta[4])) if shape["hardens"] else (0.0, 0.0)

        def step(state: StepState) -> tuple[float, float]:
            q = float(state.q[joint])
            x = q - middle
            return k * q + c + square * x**2 + cube * x**3 + loop(state)[0], 0.0

        return step

    def given(self, ctx: Context, joint: int, shape: Shape) -> dict[str, list[float]]:
        """The middle of the travel, from which it hardens."""
        return {"middle": [self._middle(ctx, joint)]}


EFFECT = CableSpring()
