"""Encoder disc off centre: an error once or twice per turn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_host.gap.effects.base import IMPOSSIBLE, Columns, Context, Effect, Shape, Value
from s2r_host.gap.motion.quantities import POSITION
from s2r_host.gap.motion.session import Session

STEP = 1e-3
FARTHEST_rad = 0.3  # of a disc


class EncoderEccentricity(Effect):
    """true q = recorded q + e sin(n q + phase), n = 1 or 2."""

    name = "encoder_eccentricity"
    model_error = {"amplitude": 0.08}  # noqa: RUF012
    equation = "q = q_recorded + e sin(n q + phase)"
    signature = "load evaluated at an angle that errs once or twice per turn"
    separating_motion = "two whole turns with an absolute reference"
    confusable = ("cogging", "encoder_offset")
    shows_over = POSITION
    part_is = "what the weight shows"
    side = "sensor"

    def applies(self, ctx: Context, joint: int) -> bool:
        """Hinges only."""
        return ctx.model.unit(ctx.model.joints[joint]) == "rad"

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Needs a good part of a turn."""
        low, high = ctx.span(joint)
        return None if high - low > 1.0 else "less than a radian of travel"

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Once or twice per turn."""
        return [{"order": 1.0}, {"order": 2.0}]

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Change of load when the motion is distorted by a small sine and cosine."""
        key = ("eccentricity", joint, shape["order"])
        if key not in s.cache:
            s.cache[key] = [
                self._distorted(ctx, s, joint, shape["order"], phase) for phase in (0.0, np.pi / 2)
            ]
        return Columns.of_motion(s.cache[key])

    def _distorted(self, ctx: Context, s: Session, joint: int, n: float, phase: float) -> np.ndarray:
        q, v, a = s.q.copy(), s.v.copy(), s.a.copy()
        x = n * s.q[:, joint] + phase
        q[:, joint] += STEP * np.sin(x)
        v[:, joint] += STEP * n * np.cos(x) * s.v[:, joint]
        a[:, joint] += STEP * n * (np.cos(x) * s.a[:, joint] - n * np.sin(x) * s.v[:, joint] ** 2)
        return (ctx.model.inverse(q, v, a) - s.load) / STEP

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Against what no disc runs out by: without gravity any force along the way asks for whole turns of error."""
        return 0.0 if float(np.hypot(*theta)) < FARTHEST_rad else IMPOSSIBLE

    def part(
        self, ctx: Context, s: Session, joint: int, shape: Shape, theta: np.ndarray
    ) -> np.ndarray | None:
        """What the weight of the links does at the wrong angle; an inertia that changes with the pose lacks it."""
        key = ("eccentric weight", joint, shape["order"])
        if key not in s.cache:
            still = np.zeros_like(s.q)
            rest = ctx.model.inverse(s.q, still, still)
            found = []
            for phase in (0.0, np.pi / 2):
                q = s.q.copy()
                q[:, joint] += STEP * np.sin(shape["order"] * s.q[:, joint] + phase)
                found.append((ctx.model.inverse(q, still, still) - rest) / STEP)
            s.cache[key] = found
        return theta[0] * s.cache[key][0] + theta[1] * s.cache[key][1]

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Amplitude, order, phase."""
        size = float(np.hypot(*theta)) + 1e-30
        g = (float(theta[0]) / size, float(theta[1]) / size)
        return {
            "amplitude": Value(size, "rad", g),
            "order": Value(shape["order"], "1/rev"),
            "phase": Value(float(np.arctan2(theta[1], theta[0])), "rad", (-g[1] / size, g[0] / size)),
        }

    def sense(
        self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray
    ) -> Callable[[float], float] | None:
        """Recorded = true - error (error taken at the true angle, equal to first order)."""
        n, a, b = shape["order"], float(theta[0]), float(theta[1])
        return lambda q: q - a * float(np.sin(n * q)) - b * float(np.cos(n * q))


EFFECT = EncoderEccentricity()
