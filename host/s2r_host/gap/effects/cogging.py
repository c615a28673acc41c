"""Cogging and other forces that repeat with position."""

from __future__ import annotations

import numpy as np
from scipy.signal import find_peaks

from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.session import Session

MIN_PERIODS = 1.2
SEEDS = 16


class Cogging(Effect):
    """tau = A sin(N q + phase)."""

    name = "cogging"
    equation = "tau = A sin(N q + phase)"
    signature = "a sine in position at a fixed order, at any speed and in both directions"
    separating_motion = "two constant speeds, both directions, over several periods"
    confusable = ("detent", "encoder_eccentricity")

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Needs some travel above the encoder step."""
        low, high = ctx.span(joint)
        least = max(float(s.q_lsb[joint]) for s in ctx.sessions)
        return None if high - low > 50 * least else "travel below 50 encoder steps"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Peaks of the residual's spectrum over position."""
        low, high = ctx.span(joint)
        travel = high - low
        least = max(float(s.q_lsb[joint]) for s in ctx.sessions)
        typical = max(float(np.median(np.abs(s.v[:, joint]))) for s in ctx.sessions)
        top = min(
            2 * np.pi / (6 * least + 1e-12), 2 * np.pi * 25.0 / max(typical, 1e-9), 2 * np.pi / travel * 300
        )
        first = 2 * np.pi * MIN_PERIODS / travel
        if top <= first:
            return []
        orders = np.arange(first, top, 2 * np.pi / travel / 4.0)
        power = np.zeros(len(orders))
        for s in ctx.sessions:
            r = ctx.residual.get((s.index, joint))
            if r is None:
                continue
            picks = slice(None, None, max(1, int(0.008 / s.dt)))
            r, q = r[picks] * np.hanning(len(r[picks])) ** 0.1, s.q[picks, joint]
            for i in range(0, len(orders), 64):
                power[i : i + 64] += np.abs(np.exp(-1j * np.outer(orders[i : i + 64], q)) @ r) ** 2
        peaks, _ = find_peaks(power)
        best = peaks[np.argsort(-power[peaks])][:SEEDS]
        if not best.size:
            best = np.array([int(np.argmax(power))])
        return [{"order": float(orders[i])} for i in best]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Order, within half a resolution cell."""
        low, high = ctx.span(joint)
        return {"order": ("linear", 2 * np.pi / (high - low) / 8.0)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Sine and cosine."""
        phase = shape["order"] * s.q[:, joint]
        return Columns([np.sin(phase), np.cos(phase)])

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
        across = (-g[1] / size, g[0] / size)
        found["phase"] = Value(float(np.arctan2(theta[1], theta[0])), "rad", across)
        return found

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Sine of position."""
        order, a, b = shape["order"], float(theta[0]), float(theta[1])

        def step(state: StepState) -> tuple[float, float]:
            x = order * float(state.q[joint])
            return a * float(np.sin(x)) + b * float(np.cos(x)), 0.0

        return step


EFFECT = Cogging()
