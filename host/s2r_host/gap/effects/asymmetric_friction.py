"""Friction that differs by direction."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.effects.viscous_friction import drives
from s2r_host.gap.motion.session import Session

EVEN = 0.1  # half difference, as a share of what both directions have in common
COMMON = (
    0.2  # of the friction in the greater direction, from which the lesser one counts as friction of its own
)


class AsymmetricFriction(Effect):
    """tau = (Fc± + b± |dq|) sgn(dq)."""

    name = "asymmetric_friction"
    equation = "tau = (Fc± + b± |dq|) sgn(dq)"
    signature = "slope or step of the residual against speed differs by the sign of the speed"
    separating_motion = "the same path both ways at two speeds"
    confusable = ("gravity_tilt", "cogging")
    contains = ("coulomb_friction", "viscous_friction")

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Needs motion in both directions."""
        signs = np.concatenate(
            [np.sign(s.v[np.abs(s.v[:, joint]) > 5 * s.v_eps[joint], joint]) for s in ctx.sessions]
        )
        both = min(np.mean(signs > 0), np.mean(signs < 0)) if signs.size else 0.0
        return None if both > 0.1 else "motion in one direction only"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Which parts differ: dry, viscous, both."""
        return [{"dry": 1.0, "viscous": 0.0}, {"dry": 0.0, "viscous": 1.0}, {"dry": 1.0, "viscous": 1.0}]

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Half differences first, then the symmetric parts: more friction in one direction is half of each."""
        sign, v = s.sign(joint), s.v[:, joint]
        linear = []
        if shape["dry"]:
            linear.append(np.abs(sign))
        if shape["viscous"]:
            linear.append(np.abs(v))
        if shape["dry"]:
            linear.append(sign)
        if shape["viscous"]:
            linear.append(v)
        return Columns(linear, (False,) * len(linear))

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Friction whose two directions hardly differ is dry and viscous friction, two simpler effects at once.

        One that falls with the speed so far that it would drive the joint is none.
        """
        part = self._split(shape, theta)
        least = float(ctx.model.model.dof_damping[joint]) + part["slope"] - abs(part["viscous"])
        dry = float(ctx.model.model.dof_frictionloss[joint]) + part["level"]
        if drives(ctx, joint, least, dry):
            return -np.inf
        halves = ((part["dry"], part["level"]), (part["viscous"], part["slope"]))
        return -np.inf if all(abs(half) <= EVEN * abs(both) for half, both in halves) else 0.0

    def _split(self, shape: Shape, theta: np.ndarray) -> dict[str, float]:
        values = list(map(float, theta))
        dry = values.pop(0) if shape["dry"] else 0.0
        viscous = values.pop(0) if shape["viscous"] else 0.0
        level = values.pop(0) if shape["dry"] else 0.0
        slope = values.pop(0) if shape["viscous"] else 0.0
        return {"dry": dry, "viscous": viscous, "level": level, "slope": slope}

    def brings(
        self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray
    ) -> dict[str, tuple[float, ...]]:
        """What the lesser direction has is no asymmetry; where the model has none of its kind, it lacks that too."""
        m, part, k = ctx.model.model, self._split(shape, theta), len(theta) // 2
        found = {}
        for name, known, half, both in (
            ("coulomb_friction", m.dof_frictionloss[joint], "dry", "level"),
            ("viscous_friction", m.dof_damping[joint], "viscous", "slope"),
        ):
            if known > 0 or not shape[half]:
                continue
            lesser, greater = part[both] - abs(part[half]), part[both] + abs(part[half])
            if lesser > COMMON * greater:
                weights = np.zeros(2 * k)
                at = k - 1 if half == "viscous" else 0
                weights[at], weights[k + at] = -np.sign(part[half]), 1.0
                found[name] = tuple(map(float, weights))
        return found

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Values per direction, added to what the model has."""
        name, model = ctx.model.joints[joint], ctx.model.model
        part = self._split(shape, theta)
        unit = ctx.model.effort_unit(name)
        found: dict[str, Value] = {}
        k = len(theta)
        if shape["dry"]:
            base = float(model.dof_frictionloss[joint]) + part["level"]
            level_at = (1 if shape["viscous"] else 0) + 1
            for label, sign in (("coulomb_positive", 1.0), ("coulomb_negative", -1.0)):
                gradient = [0.0] * k
                gradient[0] = sign
                gradient[level_at] = 1.0
                found[label] = Value(base + sign * part["dry"], unit, tuple(gradient))
        if shape["viscous"]:
            base = float(model.dof_damping[joint]) + part["slope"]
            at = 1 if shape["dry"] else 0
            for label, sign in (("viscous_positive", 1.0), ("viscous_negative", -1.0)):
                gradient = [0.0] * k
                gradient[at] = sign
                gradient[-1] = 1.0
                found[label] = Value(
                    base + sign * part["viscous"], ctx.model.damping_unit(name), tuple(gradient)
                )
        return found

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Dry part as friction loss by direction, viscous part as force."""
        p = self._split(shape, theta)

        def step(state: StepState) -> tuple[float, float]:
            v = float(state.v[joint])
            return p["viscous"] * abs(v) + p["slope"] * v, p["level"] + (p["dry"] if v > 0 else -p["dry"])

        return step


EFFECT = AsymmetricFriction()
