"""Between the commanded effort and the effort at the motor.

Sources: delay and lag, Franklin, Powell, Emami-Naeini, Feedback Control of Dynamic Systems, ch. 5; speed-torque
limit of a direct-current motor, ``|u| ≤ limit (1 − |v|/no_load_speed)`` in the driving quadrants, e.g.
Siciliano et al., Robotics: Modelling, Planning and Control, section 5.2.
"""

from __future__ import annotations

import numpy as np

from s2r_conceal.effects.base import Effect, Hook, sign
from s2r_conceal.motions import RATE_HZ
from s2r_conceal.parameters import Scale
from s2r_conceal.plant import State


class _Delay(Hook):
    """Effort arrives ``delay`` seconds late, as held samples."""

    order = 10

    def begin(self, s: State) -> None:
        depth = int(np.ceil(self.p["delay"].max(initial=0.0) * RATE_HZ)) + 2
        self._past = np.zeros((depth, self.idx.size))
        self._newest, self._since, self._last = 0, 0.0, -np.inf
        self._columns = np.arange(self.idx.size)

    def drive(self, s: State) -> None:
        tick = round((s.t + 0.5 * s.h) * RATE_HZ - 0.5)
        if tick != self._last:
            self._newest = (self._newest + 1) % len(self._past)
            self._past[self._newest] = s.u[self.idx]
            self._last = tick
        into = s.t - tick / RATE_HZ
        back = np.ceil((self.p["delay"] - into) * RATE_HZ - 1e-6).astype(int)
        late = self._past[(self._newest - np.maximum(back, 0)) % len(self._past), self._columns]
        self.contribution = late - s.u_drive[self.idx]
        s.u_drive[self.idx] = late


class _Bandwidth(Hook):
    """First-order lag ``time_constant du/dt = u_cmd − u``."""

    order = 20

    def begin(self, s: State) -> None:
        self._lagged = np.zeros(self.idx.size)

    def drive(self, s: State) -> None:
        asked = s.u_drive[self.idx]
        self._lagged = asked + (self._lagged - asked) * np.exp(-s.h / self.p["time_constant"])
        self.contribution = self._lagged - asked
        s.u_drive[self.idx] = self._lagged


class _Saturation(Hook):
    """Effort clipped at ``torque_max · (1 − reduction)``, falling to zero at ``no_load_speed``."""

    order = 30

    def drive(self, s: State) -> None:
        asked = s.u_drive[self.idx]
        speed = np.sign(asked) * s.v_motor[self.idx]
        slope = 1.0 - np.minimum(np.maximum(speed, 0.0) / self.p["no_load_speed"], 1.0)
        limit = self.p["torque_max"] * (1.0 - self.p["reduction"]) * slope
        clipped = np.minimum(np.maximum(asked, -limit), limit)
        self.contribution = clipped - asked
        s.u_drive[self.idx] = clipped


class _EffortScale(Hook):
    """True torque is ``1 + deviation`` times the reported one: a wrong torque constant or gear."""

    order = 40

    def drive(self, s: State) -> None:
        if s.u_report is s.u_drive:
            s.u_report = s.u_drive.copy()
        self.contribution = self.p["deviation"] * self.p["direction"] * s.u_drive[self.idx]
        s.u_drive[self.idx] += self.contribution


def _saturation(rng: np.random.Generator, c: Scale) -> dict[str, float]:
    return {"torque_max": c.torque_max, "no_load_speed": rng.uniform(3.0, 12.0) * c.speed_max}


EFFECTS = (
    Effect(
        "actuator_delay",
        lambda rng, c: {},
        "delay",
        lambda c, _: (2e-4, 0.35 / c.bandwidth),
        {"delay": "s"},
        "whenever the effort changes",
        _Delay,
        same_as=("bandwidth",),
    ),
    Effect(
        "bandwidth",
        lambda rng, c: {},
        "time_constant",
        lambda c, _: (2e-4, 0.35 / c.bandwidth),
        {"time_constant": "s"},
        "whenever the effort changes",
        _Bandwidth,
        same_as=("actuator_delay",),
    ),
    Effect(
        "saturation",
        _saturation,
        "reduction",
        lambda c, _: (-0.1, 0.6),
        {"reduction": "1", "torque_max": "N·m", "no_load_speed": "rad/s"},
        "while the effort asked for is above the limit",
        _Saturation,
    ),
    Effect(
        "effort_scale",
        lambda rng, c: {"direction": sign(rng)},
        "deviation",
        lambda c, _: (1e-3, 0.35),
        {"deviation": "1", "direction": "1"},
        "in proportion to the effort",
        _EffortScale,
    ),
)
