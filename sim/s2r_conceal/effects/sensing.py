"""Between the true position and the recorded one.

Sources: encoder eccentricity, ``A sin(k q + φ)`` with k = 1 or 2 per turn, Mancini et al. on optical encoders,
and Heidenhain, Rotary Encoders (measuring accuracy, mounting eccentricity).  Late stamps leave the loop as it
is and only shift the recorded position against the recorded effort.
"""

from __future__ import annotations

import numpy as np

from s2r_conceal.effects.base import Effect, Hook, sign
from s2r_conceal.motions import RATE_HZ
from s2r_conceal.plant import State, Trace


class _EncoderOffset(Hook):
    """Measured position is ``offset`` too large."""

    def begin(self, s: State) -> None:
        offset = self.p["offset"] * self.p["direction"]
        s.q[self.idx] -= offset
        self.contribution = offset

    def sense(self, s: State, q: np.ndarray, dq: np.ndarray) -> None:
        q[self.idx] += self.contribution


class _Eccentricity(Hook):
    """Measured position errs by ``amplitude sin(order q + phase)``; its speed by the derivative."""

    order = 70  # turns with what it measures, a motor behind a spring or play as well as a joint

    def sense(self, s: State, q: np.ndarray, dq: np.ndarray) -> None:
        angle = self.p["order"] * q[self.idx] + self.p["phase"]
        self.contribution = self.p["amplitude"] * np.sin(angle)
        q[self.idx] += self.contribution
        dq[self.idx] += self.p["amplitude"] * self.p["order"] * np.cos(angle) * s.v_motor[self.idx]


def _late(trace: Trace, joint: int, values: dict[str, float]) -> None:
    """Position and velocity recorded ``delay`` late; linear between control ticks, in whole steps of the encoder."""
    t = np.arange(len(trace.q)) / RATE_HZ
    late = t - values["delay"]
    q, trace.dq[:, joint] = (np.interp(late, t, channel[:, joint]) for channel in (trace.q, trace.dq))
    # A recorder gets counts however late it is: values between them would give the effect away.
    trace.q[:, joint] = q if trace.lsb is None else np.rint(q / trace.lsb[joint]) * trace.lsb[joint]


def _speed(trace: Trace, joint: int, values: dict[str, float]) -> np.ndarray:
    return trace.dq[:, joint]


EFFECTS = (
    Effect(
        "clock_skew",
        lambda rng, c: {},
        "delay",
        lambda c, _: (1e-5, 0.06),
        {"delay": "s"},
        "whenever the joint moves, between the channels",
        log=_late,
        trace=_speed,
    ),
    Effect(
        "encoder_offset",
        lambda rng, c: {"direction": sign(rng)},
        "offset",
        lambda c, _: (3e-4, 0.25),
        {"offset": "rad", "direction": "1"},
        "everywhere, with the pose",
        _EncoderOffset,
        same_as=("gravity_tilt",),
    ),
    Effect(
        "encoder_eccentricity",
        lambda rng, c: {"order": float(rng.integers(1, 3)), "phase": rng.uniform(-np.pi, np.pi)},
        "amplitude",
        lambda c, _: (2e-4, 0.08),
        {"amplitude": "rad", "order": "1/rad", "phase": "rad"},
        "along the stroke, once or twice per turn",
        _Eccentricity,
    ),
)
