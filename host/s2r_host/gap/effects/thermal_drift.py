"""Friction or drive gain that drifts while the machine warms up."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from s2r_host.gap.effects.base import IMPOSSIBLE, Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import TIME, WARMING_UP, Quantity
from s2r_host.gap.motion.session import Session

FRICTION, DAMPING, GAIN, ALL = 0.0, 1.0, 2.0, 3.0
WORD = {FRICTION: "friction", DAMPING: "damping", GAIN: "gain"}
PER_KELVIN = (0.005, 0.015, 0.04, 0.08)
LEAST_S, LEAST_SHARE = 2.0, 0.1  # shortest time constant: seconds, and share of the longest recording
MOST_POINTS = 500  # of a warming, which is slow, in the simulation
PER_WARMING = (0.1, 0.4, 1.0, 2.0)  # of the final warming, where no temperature is recorded


class ThermalDrift(Effect):
    """tau = c x times sgn(dq), dq or load, or all friction times exp(-k x), with the warming x.

    x is (temp - temp0) where every fitted recording has a temperature (a coefficient has one unit), else the
    first-order answer, of time constant T, to the square of the effort (Joule heat). A lubricant thins exponentially
    with temperature and acts on dry and viscous friction alike (Bittencourt and Gunnarsson, Static friction in a robot
    joint, J. Dyn. Sys. 134, 2012).
    """

    name = "thermal_drift"
    model_error = {"per_kelvin": 0.08}  # noqa: RUF012
    equation = "tau = c x {sgn dq | dq | load}, or all friction times exp(-k x), T dx/dt = heat - x"
    signature = "one regressor whose coefficient drifts over the recording"
    separating_motion = "repeat the first motion at the end"
    confusable = ("session_friction", "payload")
    shows_over = WARMING_UP
    contains = ("coulomb_friction", "viscous_friction")

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Needs some length, and the same places again when warmer."""
        if ctx.turns(joint) < 2:
            return "fewer than two reversals: warming and place cannot be told apart"
        longest = max(float(s.t[-1]) for s in ctx.sessions)
        return None if longest > 5.0 else f"the longest recording lasts {longest:.1f} s"

    def shown_over(self, shape: Shape) -> Quantity:
        """A gain that drifts has no direction."""
        return TIME if shape.get("target") == GAIN else self.shows_over

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Three targets; time constants as shares of the longest recording."""
        longest = max(float(s.t[-1]) for s in ctx.sessions)
        times = (0.1, 0.3, 1.0, 4.0)
        if self._in_kelvin(ctx, joint):
            times = (1.0,)
        rates = PER_WARMING if len(times) > 1 else PER_KELVIN
        constants = [max(LEAST_S, longest * x) for x in times]
        linear = [{"T": T, "target": target} for T in constants for target in (FRICTION, DAMPING, GAIN)]
        if not self._rubs(ctx, joint):
            return linear
        return linear + [{"T": T, "target": ALL, "k": k} for T in constants for k in rates]

    def _rubs(self, ctx: Context, joint: int) -> bool:
        m = ctx.model.model
        return bool(m.dof_frictionloss[joint] > 0 or m.dof_damping[joint] > 0)

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Time constant and temperature coefficient on a log scale."""
        if self._in_kelvin(ctx, joint):
            return {"k": ("log", 0.3)}
        return {"T": ("log", 0.4), "k": ("log", 0.3)}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """What follows the effort at once is no warming."""
        longest = max(float(s.t[-1]) for s in ctx.sessions)
        return {"T": (max(LEAST_S, LEAST_SHARE * longest), 10.0 * longest)}

    def _temperature(self, ctx: Context, s: Session, joint: int) -> np.ndarray | None:
        return s.channel("temp", ctx.model.joints[joint])

    def _in_kelvin(self, ctx: Context, joint: int) -> bool:
        return all(self._temperature(ctx, s, joint) is not None for s in ctx.sessions)

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Drift times what drifts."""
        drift = self._warming(ctx, s, joint, shape["T"])
        target = shape["target"]
        if target == ALL:
            return self._thinning(ctx, s, joint, np.exp(-shape["k"] * drift))
        what = (
            s.sign(joint) if target == FRICTION else s.v[:, joint] if target == DAMPING else s.load[:, joint]
        )
        linear, positive = [drift * what], [False]
        model = ctx.model.model
        if target == FRICTION and not model.dof_frictionloss[joint]:
            linear.append(what)
            positive.append(True)
        if target == DAMPING and not model.dof_damping[joint]:
            linear.append(what)
            positive.append(True)
        return Columns(linear, tuple(positive))

    def _warming(self, ctx: Context, s: Session, joint: int, T: float) -> np.ndarray:
        if self._in_kelvin(ctx, joint):
            temperature = self._temperature(ctx, s, joint)
            # Of a recording held out without one nothing is known: as it began, and not a warming in another unit.
            return np.zeros(len(s.t)) if temperature is None else temperature - temperature[0]
        heat = np.nan_to_num(s.drive(joint)) ** 2
        keep = float(np.exp(-s.dt / T))
        x = lfilter([1.0 - keep], [1.0, -keep], heat / max(float(np.mean(heat)), 1e-30))
        return np.asarray(x)

    def _thinning(self, ctx: Context, s: Session, joint: int, factor: np.ndarray) -> Columns:
        """What is left of the model's friction; dry or viscous friction it lacks, thinning alike."""
        m = ctx.model.model
        kinds = [
            (float(m.dof_frictionloss[joint]), s.sign(joint)),
            (float(m.dof_damping[joint]), s.v[:, joint]),
        ]
        known = np.sum([level * x for level, x in kinds], axis=0)
        linear = [factor * x for level, x in kinds if level <= 0]
        return Columns(linear, (True,) * len(linear), fixed=(factor - 1.0) * known)

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Against friction that grows with warming: dirt or wear, and no lubricant."""
        grows = shape["target"] in (FRICTION, DAMPING) and float(theta[0]) > 0.0
        return IMPOSSIBLE if grows else 0.0

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Final change, or temperature coefficient, and time constant."""
        if shape["target"] == ALL:
            warm = self._in_kelvin(ctx, joint)
            found = {
                "per_kelvin" if warm else "per_warming": Value(
                    shape["k"], "1/K" if warm else "1", shape_key="k"
                )
            }
            if not warm:
                found["time_constant"] = Value(shape["T"], "s", shape_key="T")
            return found
        name = ctx.model.joints[joint]
        units = {FRICTION: ctx.model.effort_unit(name), DAMPING: ctx.model.damping_unit(name), GAIN: "1"}
        g = (1.0, 0.0)[: len(theta)]
        return {
            f"{WORD[shape['target']]}_change": Value(float(theta[0]), units[shape["target"]], g),
            "time_constant": Value(shape["T"], "s", shape_key="T"),
        }

    def brings(
        self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray
    ) -> dict[str, tuple[float, ...]]:
        """Friction the model lacks, cold."""
        m = ctx.model.model
        dry, viscous = m.dof_frictionloss[joint] > 0, m.dof_damping[joint] > 0
        if shape["target"] != ALL:
            lacks = {FRICTION: not dry, DAMPING: not viscous}.get(shape["target"], False)
            return (
                {"coulomb_friction" if shape["target"] == FRICTION else "viscous_friction": (0.0, 1.0)}
                if lacks
                else {}
            )
        missing = [n for n, known in (("coulomb_friction", dry), ("viscous_friction", viscous)) if not known]
        return {name: (*(0.0,) * i, 1.0) for i, name in enumerate(missing)}

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Time-dependent force or friction loss; heat by the effort counts as its mean."""
        if shape["target"] == ALL:
            return self._thinning_runtime(ctx, joint, shape, theta)
        c, T, target = float(theta[0]), shape["T"], shape["target"]
        flat = float(theta[1]) if len(theta) > 1 else 0.0

        def step(state: StepState) -> tuple[float, float]:
            now = flat + c * (1.0 - float(np.exp(-state.t / T)))
            if target == FRICTION:
                return 0.0, now
            return now * float(state.v[joint] if target == DAMPING else state.load[joint]), 0.0

        return step

    def given(self, ctx: Context, joint: int, shape: Shape) -> dict[str, list[float]]:
        """The first recording's warming, and the dry and viscous friction that thins."""
        if shape["target"] != ALL:
            return {}
        s, m = ctx.sessions[0], ctx.model.model
        few = np.linspace(0.0, float(s.t[-1]), MOST_POINTS)
        return {
            "t": few.tolist(),
            "warming": np.interp(few, s.t, self._warming(ctx, s, joint, shape["T"])).tolist(),
            "friction": [float(m.dof_frictionloss[joint]), float(m.dof_damping[joint])],
        }

    def _thinning_runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> Runtime:
        """Warming as a function of time, as the first recording has it."""
        given = ctx.given or self.given(ctx, joint, shape)
        t, x, (dry, viscous) = given["t"], given["warming"], given["friction"]
        more = [float(y) for y in theta]
        new_dry = more.pop(0) if dry <= 0 and more else 0.0
        new_viscous = more.pop(0) if viscous <= 0 and more else 0.0

        def step(state: StepState) -> tuple[float, float]:
            factor = float(np.exp(-shape["k"] * np.interp(state.t, t, x)))
            lost = factor - 1.0
            drag = lost * viscous + factor * new_viscous
            return drag * float(state.v[joint]), lost * dry + factor * new_dry

        return step


EFFECT = ThermalDrift()
