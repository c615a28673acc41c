"""Torque as a function of position: cogging, cables, springs, latches, stops and door dampers.

Sources: cogging, Krishnan, Permanent Magnet Synchronous and Brushless DC Motor Drives, ch. 1; contact at the
end stop, Hunt and Crossley, "Coefficient of restitution interpreted as damping in vibroimpact", J. Appl.
Mech. 42, 1975; the latch is the derivative of a Gaussian well, the usual local model of a magnet pair; cables
and door hardware follow the description of the catalogue (slow polynomial plus bending loop; one-way damper).
"""

from __future__ import annotations

import numpy as np

from s2r_conceal.effects.base import Effect, Hook, log_uniform, sign
from s2r_conceal.parameters import Scale
from s2r_conceal.plant import State


class _Cogging(Hook):
    """``amplitude sin(order q + phase)`` on the motor side."""

    def force(self, s: State) -> None:
        pull = self.p["amplitude"] * np.sin(self.p["order"] * s.q[self.idx] + self.p["phase"])
        s.f_motor[self.idx] += pull
        self.contribution = pull


class _CableSpring(Hook):
    """``stiffness (x + cubic x³)`` with x = q − rest, plus a bending loop ``bend`` per stiffness."""

    def begin(self, s: State) -> None:
        self._z = np.zeros(self.idx.size)

    def force(self, s: State) -> None:
        x = s.q[self.idx] - self.p["rest"]
        step = s.h * s.v[self.idx] / self.p["bend_angle"]
        self._z = np.minimum(np.maximum(self._z + step, -1.0), 1.0)
        loop = self.p["bend"] * self._z
        self.contribution = self.p["stiffness"] * (x + self.p["cubic"] * x**3 + loop)
        s.f_link[self.idx] -= self.contribution


class _SpringReturn(Hook):
    """A preloaded spring that always pulls one way: ``stiffness (q − rest)``, rest outside the motion."""

    def force(self, s: State) -> None:
        self.contribution = self.p["stiffness"] * (s.q[self.idx] - self.p["rest"])
        s.f_link[self.idx] -= self.contribution


class _Detent(Hook):
    """Latch at ``place``: ``−peak (x/width) exp((1 − (x/width)²)/2)``; its largest pull is ``peak``."""

    def force(self, s: State) -> None:
        x = (s.q[self.idx] - self.p["place"]) / self.p["width"]
        self.contribution = -self.p["peak"] * x * np.exp(0.5 * (1.0 - np.minimum(x * x, 80.0)))
        s.f_link[self.idx] += self.contribution


class _SoftEndStop(Hook):
    """Beyond ``place``: ``stiffness x (1 + dissipation dx/dt)``, pushing back only."""

    def force(self, s: State) -> None:
        side = self.p["side"]
        x = np.maximum(side * (s.q[self.idx] - self.p["place"]), 0.0)
        push = self.p["stiffness"] * x * (1.0 + self.p["dissipation"] * side * s.v[self.idx])
        self.contribution = np.maximum(push, 0.0)
        s.f_link[self.idx] -= side * self.contribution


class _SoftClose(Hook):
    """Damper near the closed end: ``damping · v`` only past ``place`` and only while closing."""

    def force(self, s: State) -> None:
        side = self.p["side"]
        x = side * (s.q[self.idx] - self.p["place"])
        depth = np.minimum(np.maximum(x / self.p["ramp"], 0.0), 1.0)
        closing = np.maximum(side * s.v[self.idx], 0.0)
        self.contribution = self.p["damping"] * depth * closing
        s.f_link[self.idx] -= side * self.contribution


def _mid(c: Scale, fraction: float) -> float:
    """A place inside the motion range; 0 and 1 are its ends."""
    return c.q_lo + fraction * (c.q_hi - c.q_lo)


def _near_end(rng: np.random.Generator, c: Scale, low: float, high: float) -> dict[str, float]:
    side = sign(rng)
    inside = rng.uniform(low, high)
    return {"side": side, "place": _mid(c, 1.0 - inside if side > 0 else inside)}


EFFECTS = (
    Effect(
        "cogging",
        lambda rng, c: {
            "order": float(rng.integers(8, 49)),
            "phase": rng.uniform(-np.pi, np.pi),
        },
        "amplitude",
        lambda c, _: (1e-3 * c.torque, 0.4 * c.torque),
        {"amplitude": "N·m", "order": "1/rad", "phase": "rad"},
        "along the whole stroke, periodic in position",
        _Cogging,
    ),
    Effect(
        "cable_spring",
        lambda rng, c: {
            "rest": _mid(c, rng.uniform(0.2, 0.8)),
            "cubic": rng.uniform(0.0, 1.0),
            "bend": rng.uniform(0.05, 0.25),
            "bend_angle": rng.uniform(0.03, 0.1),
        },
        "stiffness",
        lambda c, _: (2e-3 * c.torque, 0.8 * c.torque),
        {"stiffness": "N·m/rad", "rest": "rad", "cubic": "1/rad²", "bend": "rad", "bend_angle": "rad"},
        "growing away from the rest position, with a loop at reversals",
        _CableSpring,
    ),
    Effect(
        "spring_return",
        lambda rng, c: {"rest": _mid(c, 0.5 + sign(rng) * rng.uniform(0.8, 1.6))},
        "stiffness",
        lambda c, _: (1e-3 * c.torque, 0.6 * c.torque),
        {"stiffness": "N·m/rad", "rest": "rad"},
        "everywhere, always the same way",
        _SpringReturn,
        same_as=("payload",),
    ),
    Effect(
        "detent",
        lambda rng, c: {
            "place": _mid(c, rng.uniform(0.25, 0.75)),
            "width": log_uniform(rng, 0.02, 0.07),
        },
        "peak",
        lambda c, _: (5e-3 * c.torque, 1.2 * c.torque),
        {"peak": "N·m", "place": "rad", "width": "rad"},
        "within a narrow range of position",
        _Detent,
    ),
    Effect(
        "soft_end_stop",
        lambda rng, c: _near_end(rng, c, 0.06, 0.22) | {"dissipation": rng.uniform(0.05, 0.4)},
        "stiffness",
        lambda c, _: (0.05 * c.torque, 60.0 * c.torque),
        {"stiffness": "N·m/rad", "place": "rad", "dissipation": "s/rad", "side": "1"},
        "beyond one end of the range",
        _SoftEndStop,
    ),
    Effect(
        "soft_close",
        lambda rng, c: _near_end(rng, c, 0.25, 0.45) | {"ramp": rng.uniform(0.02, 0.1)},
        "damping",
        lambda c, _: (0.01 * c.torque / c.speed, 4.0 * c.torque / c.speed),
        {"damping": "N·m·s/rad", "place": "rad", "ramp": "rad", "side": "1"},
        "near one end, only while closing",
        _SoftClose,
    ),
)
