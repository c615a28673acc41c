"""Cogging, and friction that changes along the travel: forces bound to position."""

from __future__ import annotations

import numpy as np
from scipy.signal import find_peaks

from s2r_host.gap.effects.base import IMPOSSIBLE, Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import PHASE, RUBBING_PHASE, Quantity
from s2r_host.gap.motion.session import Session

MIN_PERIODS = 1.2
MAX_PERIODS = 2000
SEEDS = 16
TOGETHER = 4  # seeds from all recordings taken as one
RUB_PERIODS, MIN_RUB_PERIODS = (0.5, 0.75, 1.0), 0.4
RUB_ODDS = -3.0


class Cogging(Effect):
    """tau = A sin(N q + phase), or the same times the direction: a friction that is not the same everywhere."""

    name = "cogging"
    equation = "tau = A sin(N q + phase) {1, sgn dq}"
    signature = "a sine in position at a fixed order, at any speed and in both directions"
    separating_motion = "two constant speeds, both directions, over several periods"
    confusable = ("detent", "encoder_eccentricity")
    shows_over = PHASE

    def shown_over(self, shape: Shape) -> Quantity:
        """A friction that changes along the travel turns with the direction."""
        return RUBBING_PHASE if shape["rub"] else self.shows_over

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Needs some travel above the encoder step."""
        low, high = ctx.span(joint)
        least = max(float(s.q_lsb[joint]) for s in ctx.sessions)
        return None if high - low > 50 * least else "travel below 50 encoder steps"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Peaks of the residual's spectrum over position, as it is and turned with the direction."""
        low, high = ctx.span(joint)
        travel = high - low
        least = max(float(s.q_lsb[joint]) for s in ctx.sessions)
        typical = max(float(np.median(np.abs(s.v[:, joint]))) for s in ctx.sessions)
        cut = max(float(s.cut[joint]) for s in ctx.sessions)
        top = min(
            2 * np.pi / (6 * least + 1e-12),
            2 * np.pi * 0.83 * cut / max(typical, 1e-9),
            2 * np.pi / travel * MAX_PERIODS,
        )
        first = 2 * np.pi * MIN_PERIODS / travel
        if top <= first:
            return []
        found = [{"order": x, "rub": 0.0} for x in _peaks(ctx, joint, first, top, False)[:SEEDS]]
        if ctx.both_ways(joint):
            slow = [2 * np.pi * x / travel for x in RUB_PERIODS]
            found += [
                {"order": x, "rub": 1.0} for x in slow + _peaks(ctx, joint, first, top, True)[: SEEDS // 2]
            ]
        return found

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """A friction that changes along the travel is the rarer machine; less than a period is no ripple.

        A friction of a small part of a period hardly changes: of none at all it is dry friction itself.
        """
        low, high = ctx.span(joint)
        least = MIN_RUB_PERIODS if shape["rub"] else MIN_PERIODS
        if shape["order"] * (high - low) < 2.0 * np.pi * least:
            return IMPOSSIBLE
        return RUB_ODDS * shape["rub"]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Order, within half a resolution cell."""
        low, high = ctx.span(joint)
        return {"order": ("linear", 2 * np.pi / (high - low) / 8.0)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Sine and cosine."""
        phase = shape["order"] * s.q[:, joint]
        turn = s.sign(joint) if shape["rub"] else 1.0
        return Columns([np.sin(phase) * turn, np.cos(phase) * turn])

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Amplitude, order (per radian of joint angle, so per turn as an integer) or pitch, phase."""
        name = ctx.model.joints[joint]
        size = float(np.hypot(*theta)) + 1e-30
        g = (float(theta[0]) / size, float(theta[1]) / size)
        found = {"amplitude": Value(size, ctx.model.effort_unit(name), g)}
        if ctx.model.unit(name) == "rad":
            found["order"] = Value(shape["order"], "1/rev", shape_key="order")
        else:
            found["spatial_frequency"] = Value(
                shape["order"] / (2 * np.pi), "1/m", shape_key="order", scale=1 / (2 * np.pi)
            )
        if shape["rub"]:
            found["turns_with_direction"] = Value(1.0, "1")
        across = (-g[1] / size, g[0] / size)
        found["phase"] = Value(float(np.arctan2(theta[1], theta[0])), "rad", across)
        return found

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Sine of position."""
        order, a, b = shape["order"], float(theta[0]), float(theta[1])
        rub = bool(shape["rub"])

        def step(state: StepState) -> tuple[float, float]:
            x = order * float(state.q[joint])
            size = a * float(np.sin(x)) + b * float(np.cos(x))
            return (0.0, size) if rub else (size, 0.0)

        return step


def _peaks(ctx: Context, joint: int, first: float, top: float, turned: bool) -> list[float]:
    """Orders at which the residual's spectrum over position peaks, strongest first.

    Strokes shorter than a period have no peak of their own: of several, taken as one, the strongest come first.
    """
    low, high = ctx.span(joint)
    orders = np.arange(first, top, 2 * np.pi / (high - low) / 4.0)
    power, whole = np.zeros(len(orders)), np.zeros(len(orders), dtype=complex)
    count = 0
    for s in ctx.sessions:
        r = ctx.residual.get((s.index, joint))
        if r is None:
            continue
        count += 1
        picks = slice(None, None, max(1, int(0.24 / float(s.cut[joint]) / s.dt)))
        r, q = r[picks] * np.hanning(len(r[picks])) ** 0.1, s.q[picks, joint]
        if turned:
            r = r * s.sign(joint)[picks]
        for i in range(0, len(orders), 64):
            spectrum = np.exp(-1j * np.outer(orders[i : i + 64], q)) @ r
            power[i : i + 64] += np.abs(spectrum) ** 2
            whole[i : i + 64] += spectrum
    alone = _strongest(orders, power)
    return [*_strongest(orders, np.abs(whole) ** 2)[:TOGETHER], *alone] if count > 1 else alone


def _strongest(orders: np.ndarray, power: np.ndarray) -> list[float]:
    peaks, _ = find_peaks(power)
    best = peaks[np.argsort(-power[peaks])]
    return [float(orders[i]) for i in (best if best.size else [int(np.argmax(power))])]


EFFECT = Cogging()
