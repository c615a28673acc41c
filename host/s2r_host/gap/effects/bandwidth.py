"""The drive follows the asked effort with a lag."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from s2r_host.gap.effects.actuator_delay import skew_seen
from s2r_host.gap.effects.base import Columns, Context, Effect, Runtime, Shape, StepState, Value
from s2r_host.gap.motion.quantities import EFFORT_SLOPE
from s2r_host.gap.motion.session import Session


class Bandwidth(Effect):
    """T d(applied)/dt = u - applied."""

    name = "bandwidth"
    model_error = {"time_constant": 0.08}  # noqa: RUF012
    equation = "T d(applied)/dt = u - applied"
    signature = "lag of the effort with amplitude roll-off"
    separating_motion = "a chirp of the commanded effort beyond 1/(2 pi T)"
    confusable = ("actuator_delay", "clock_skew", "joint_elasticity")
    shows_over = EFFORT_SLOPE
    side = "actuator"

    def applies(self, ctx: Context, joint: int) -> bool:
        """Measured effort already contains the lag."""
        return any(s.rec.effort == "commanded" for s in ctx.sessions)

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Time constants from 2 to 200 ms."""
        return [{"T": x} for x in (0.002, 0.003, 0.005, 0.008, 0.012, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2)]

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Time constant on a log scale."""
        return {"T": ("log", 0.2)}

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """What was asked minus what arrived."""
        u = s.drive(joint)
        keep = float(np.exp(-s.dt / shape["T"]))
        lagged, _ = lfilter([1.0 - keep], [1.0, -keep], u, zi=[keep * u[0]])
        return Columns([], fixed=u - lagged)

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """The control law, recomputed from the record, shows whether the clocks differ."""
        return -skew_seen(ctx, joint)

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Time constant and the cut-off it means."""
        return {
            "time_constant": Value(shape["T"], "s", shape_key="T"),
            "cutoff": Value(1.0 / (2.0 * np.pi * shape["T"]), "Hz"),
        }

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """First-order filter state."""
        keep = float(np.exp(-dt / shape["T"]))
        state_u: float | None = None

        def step(state: StepState) -> tuple[float, float]:
            nonlocal state_u
            u = float(state.u[joint])
            state_u = u if state_u is None else keep * state_u + (1.0 - keep) * u
            return u - state_u, 0.0

        return step


EFFECT = Bandwidth()
