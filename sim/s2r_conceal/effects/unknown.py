"""Eight families that the catalogue does not hold; naming one of its entries for these is a wrong name.

Sources: parametric stiffness, Mathieu 1868; the belt's slack strand is a driven Duffing oscillator in its
chaotic range, Moon and Holmes, "A magnetoelastic strange attractor", J. Sound Vib. 65, 1979; the others are
written from the description beside each class.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_conceal.effects.base import Effect, Hook, log_uniform, sign
from s2r_conceal.parameters import Scale
from s2r_conceal.plant import State


class _Vibration(Hook):
    """A machine nearby shakes the joint: ``amplitude sin(2π frequency t + phase)``, whatever the joint does."""

    def force(self, s: State) -> None:
        wave = np.sin(2.0 * np.pi * self.p["frequency"] * s.t + self.p["phase"])
        self.contribution = self.p["amplitude"] * np.ones(self.idx.size)
        s.f_link[self.idx] += self.p["amplitude"] * wave


class _Push(Hook):
    """Somebody pushes for a moment, twice: raised-cosine pulses of ``torque``."""

    def force(self, s: State) -> None:
        total = np.zeros(self.idx.size)
        for begin in ("first", "second"):
            x = (s.t - self.p[begin]) / self.p["length"]
            total += np.where((x > 0.0) & (x < 1.0), 0.5 - 0.5 * np.cos(2.0 * np.pi * x), 0.0)
        self.contribution = self.p["torque"] * total
        s.f_link[self.idx] += self.contribution


class _PoseInertia(Hook):
    """A hidden linkage: inertia ``extra sin²((q − place)/2 · order)`` with its own centrifugal term."""

    def force(self, s: State) -> None:
        angle = self.p["order"] * (s.q[self.idx] - self.p["place"])
        inertia = 0.5 * self.p["extra"] * (1.0 - np.cos(angle))
        slope = 0.5 * self.p["extra"] * self.p["order"] * np.sin(angle)
        s.inertia_extra[self.idx] += inertia
        centrifugal = 0.5 * slope * s.v[self.idx] ** 2
        s.f_link[self.idx] -= centrifugal
        self.contribution = inertia * s.acceleration[self.idx] + centrifugal


class _ParametricStiffness(Hook):
    """A spring whose stiffness breathes in time: ``stiffness sin(2π frequency t) (q − rest)``."""

    def force(self, s: State) -> None:
        x = s.q[self.idx] - self.p["rest"]
        self.contribution = self.p["stiffness"] * x
        s.f_link[self.idx] -= self.contribution * np.sin(2.0 * np.pi * self.p["frequency"] * s.t)


class _Dropout(Hook):
    """The position sensor freezes for ``length`` once per ``period`` and the controller believes it."""

    def begin(self, s: State) -> None:
        self._held = s.q[self.idx].copy()

    def sense(self, s: State, q: np.ndarray, dq: np.ndarray) -> None:
        phase = np.mod(s.t + self.p["phase"], self.p["period"])
        frozen = (phase < self.p["length"]) & (s.t > 0.1)
        self._held = np.where(frozen, self._held, q[self.idx])
        self.contribution = frozen * (np.abs(self._held - q[self.idx]) + 1e-9)
        q[self.idx] = self._held


class _CrossTalk(Hook):
    """Motor current leaks into the position signal: ``leak · u²`` of the tick before."""

    def sense(self, s: State, q: np.ndarray, dq: np.ndarray) -> None:
        self.contribution = self.p["leak"] * (s.u_drive[self.idx] / self.p["torque"]) ** 2
        q[self.idx] += self.contribution


class _SecondBody(Hook):
    """A loose body sticks to the link on passing ``place`` upwards and falls off on passing it downwards.

    It adds inertia and a constant torque while attached and takes up speed at once (inelastic catch).
    """

    def begin(self, s: State) -> None:
        self._attached = s.q[self.idx] > self.p["place"]

    def force(self, s: State) -> None:
        now = s.q[self.idx] > self.p["place"]
        caught = now & ~self._attached
        if caught.any():
            before = self.p["link_inertia"]
            kept = np.where(caught, before / (before + self.p["inertia"]), 1.0)
            s.v = s.v.copy()
            s.v[self.idx] *= kept
        self._attached = now
        s.inertia_extra[self.idx] += self.p["inertia"] * now
        weight = self.p["inertia"] * self.p["weight_ratio"]
        self.contribution = weight * now
        s.f_link[self.idx] -= self.contribution


class _ChaoticBelt(Hook):
    """A slack belt: a double-well strand ``x'' = ω² (−δ x' + x − x³ + γ cos Ωt + v-drive)`` pulls the joint."""

    def begin(self, s: State) -> None:
        self._x = 0.1 * np.ones(self.idx.size)
        self._dx = np.zeros(self.idx.size)

    def force(self, s: State) -> None:
        w = self.p["rate"]
        drive = 0.36 * np.cos(1.2 * w * s.t) + self.p["stir"] * s.v[self.idx]
        acceleration = -0.3 * self._dx + self._x - self._x**3 + drive
        self._dx = self._dx + s.h * w * acceleration
        self._x = np.clip(self._x + s.h * w * self._dx, -3.0, 3.0)
        self.contribution = self.p["torque"] * self._x
        s.f_link[self.idx] += self.contribution


def _torque(low: float, high: float) -> Callable[[Scale, dict[str, float]], tuple[float, float]]:
    """Sizes as fractions of the typical torque."""
    return lambda c, _: (low * c.torque, high * c.torque)


EFFECTS = (
    Effect(
        "vibration",
        lambda rng, c: {"frequency": log_uniform(rng, 1.0, 18.0), "phase": rng.uniform(-np.pi, np.pi)},
        "amplitude",
        _torque(2e-3, 0.8),
        {"amplitude": "N·m", "frequency": "Hz", "phase": "rad"},
        "all the time, tied to the clock",
        _Vibration,
        known=False,
    ),
    Effect(
        "push",
        lambda rng, c: {
            "first": rng.uniform(0.1, 0.4) * c.duration_s,
            "second": rng.uniform(0.55, 0.85) * c.duration_s,
            "length": rng.uniform(0.3, 1.2),
        },
        "torque",
        _torque(0.01, 2.5),
        {"torque": "N·m", "first": "s", "second": "s", "length": "s"},
        "during two moments",
        _Push,
        known=False,
    ),
    Effect(
        "pose_inertia",
        lambda rng, c: {
            "order": float(rng.integers(2, 5)),
            "place": c.q_lo + rng.uniform(0, 1) * (c.q_hi - c.q_lo),
        },
        "extra",
        lambda c, _: (5e-3 * c.inertia, 3.0 * c.inertia),
        {"extra": "kg·m²", "order": "1", "place": "rad"},
        "with acceleration and speed squared, by pose",
        _PoseInertia,
        known=False,
    ),
    Effect(
        "parametric_stiffness",
        lambda rng, c: {
            "frequency": log_uniform(rng, 0.4, 4.0),
            "rest": c.q_lo + rng.uniform(0.2, 0.8) * (c.q_hi - c.q_lo),
        },
        "stiffness",
        _torque(5e-3, 2.0),
        {"stiffness": "N·m/rad", "frequency": "Hz", "rest": "rad"},
        "away from the rest position, tied to the clock",
        _ParametricStiffness,
        known=False,
    ),
    Effect(
        "sensor_dropout",
        lambda rng, c: {"period": rng.uniform(1.7, 3.5), "phase": rng.uniform(0.0, 1.5)},
        "length",
        lambda c, _: (3e-3, 0.25),
        {"length": "s", "period": "s", "phase": "s"},
        "during short moments",
        _Dropout,
        known=False,
    ),
    Effect(
        "cross_talk",
        lambda rng, c: {"torque": c.torque},
        "leak",
        lambda c, _: (1e-4, 0.03),
        {"leak": "rad", "torque": "N·m"},
        "with the square of the effort",
        _CrossTalk,
        known=False,
    ),
    Effect(
        "second_body",
        lambda rng, c: {
            "place": c.q_lo + rng.uniform(0.35, 0.75) * (c.q_hi - c.q_lo),
            "link_inertia": c.inertia,
            "weight_ratio": rng.uniform(0.3, 1.0) * c.gravity / c.inertia,
        },
        "inertia",
        lambda c, _: (2e-3 * c.inertia, 0.6 * c.inertia),
        {"inertia": "kg·m²", "place": "rad", "link_inertia": "kg·m²", "weight_ratio": "1/s²"},
        "beyond one place, from the moment of the catch",
        _SecondBody,
        known=False,
    ),
    Effect(
        "chaotic_belt",
        lambda rng, c: {
            "rate": 2.0 * np.pi * log_uniform(rng, 0.6, 3.0),
            "stir": rng.uniform(0.05, 0.3) * sign(rng),
        },
        "torque",
        _torque(2e-3, 0.6),
        {"torque": "N·m", "rate": "rad/s", "stir": "s/rad"},
        "all the time, never the same twice",
        _ChaoticBelt,
        known=False,
    ),
)
