"""A correction without a name: an effort over position, direction and speed, as one more term of a simulation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Context, Effect, Runtime, Shape, StepState

BINS = 14


class GenericCorrection(Effect):
    """What is left over on one joint, bin by bin. It is in no catalogue: it names nothing and is never searched for."""

    name = "generic_correction"
    equation = "tau = f(q) + g(q) sgn dq + h(q) dq + k(dq)"
    separating_motion = "none: it stands for whatever was left over along the recorded motion"

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Coefficients ``theta`` of ``features`` at the position and speed of the joint."""

        def step(state: StepState) -> tuple[float, float]:
            q, v = state.q[joint : joint + 1], state.v[joint : joint + 1]
            return float(features(q, v, shape)[0] @ theta), 0.0

        return step


GENERIC = GenericCorrection()


def forms() -> Mapping[str, Effect]:
    """All that a simulation may hold as a term: the catalogue, and what has no name in it."""
    return catalogue() | {GENERIC.name: GENERIC}


def features(q: np.ndarray, v: np.ndarray, shape: Shape) -> np.ndarray:
    """Hats over position, per direction; speed shapes; shape (time, k).

    Args:
        q, v: Position [rad or m] and speed [rad/s or m/s] of one joint, shape (time,).
        shape: Ends ``low`` and ``high`` of the travel, ``v_eps`` the speed that is noise, ``top`` the highest one.
    """
    low, high, top = shape["low"], shape["high"], shape["top"]
    sign = np.tanh(v / shape["v_eps"])
    width = (high - low) / (BINS - 1) + 1e-12
    centres = np.linspace(low, high, BINS)
    hats = np.maximum(0.0, 1.0 - np.abs(np.clip(q, low, high)[:, None] - centres) / width)
    speed = np.stack(
        [v / top, np.abs(v) / top, v * np.abs(v) / top**2, sign * np.exp(-((v / (0.1 * top)) ** 2))], axis=1
    )
    return np.concatenate([hats, hats * sign[:, None], hats * (v / top)[:, None], speed], axis=1)
