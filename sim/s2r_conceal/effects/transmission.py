"""Between motor and load: play, elasticity, and the pull of a neighbouring motor.

Two masses: ``J dω = u − friction − τ``, load driven by ``τ = k x + d (ω − v)`` with ``x`` the windup beyond
the dead zone.  Sources: Spong, "Modeling and control of elastic joint robots", JDSMC 109, 1987; Nordin and
Gutman, "Controlling mechanical systems with backlash: a survey", Automatica 38(10), 2002 (dead zone with
damping that never pulls); Murphy, Wen and Saridis, "Simulation and analysis of flexibly jointed manipulators",
CDC 1990, and Sciavicco et al. on gear coupling in wrists (motor coupling).
"""

from __future__ import annotations

import numpy as np

from s2r_conceal.effects.base import Effect, Hook, log_uniform
from s2r_conceal.parameters import Scale
from s2r_conceal.plant import State


class _TwoMass(Hook):
    """A motor with its own angle and speed; friction and motor forces act on its side."""

    order = 60

    def begin(self, s: State) -> None:
        s.rigid[self.idx] = False
        self.speed = np.zeros(self.idx.size)
        self._angle = s.q[self.idx].copy()
        self._friction = np.zeros(self.idx.size)
        s.transmissions.append((self.idx, self))

    def _torque(self, s: State) -> np.ndarray:
        raise NotImplementedError

    def transmit(self, s: State, motor: np.ndarray) -> None:
        torque = self._torque(s)
        gain = s.h / s.armature[self.idx]
        free = self.speed + gain * (motor[self.idx] - torque)
        low, high = -gain * s.bound_minus[self.idx], gain * s.bound_plus[self.idx]
        self.speed = free - np.minimum(np.maximum(free, low), high)
        self._angle = self._angle + s.h * self.speed
        motor[self.idx] = torque
        s.bound_plus[self.idx] = s.bound_minus[self.idx] = 0.0

    def sense(self, s: State, q: np.ndarray, dq: np.ndarray) -> None:
        at_motor = self.p["encoder_at_motor"] > 0.5
        dq[self.idx] += self.speed - s.v[self.idx]  # speed is sensed at the motor, as drives do
        q[self.idx] += np.where(
            at_motor, self._angle - s.q[self.idx], 0.0
        )  # on top of what the encoder errs by


class _Elasticity(_TwoMass):
    """Spring of ``1/compliance`` and damper between motor and load."""

    def _torque(self, s: State) -> np.ndarray:
        stiffness = 1.0 / self.p["compliance"]
        windup = self._angle - s.q[self.idx]
        self.contribution = windup
        return stiffness * windup + self.p["damping"] * (self.speed - s.v[self.idx])


class _Backlash(_TwoMass):
    """Dead zone of ``half_width`` on either side, stiff and damped flanks that push but never pull."""

    def _torque(self, s: State) -> np.ndarray:
        windup = self._angle - s.q[self.idx]
        width = self.p["half_width"]
        beyond = windup - np.minimum(np.maximum(windup, -width), width)
        push = self.p["flank"] * beyond + self.p["damping"] * (self.speed - s.v[self.idx])
        push = np.where(beyond > 0, np.maximum(push, 0.0), np.where(beyond < 0, np.minimum(push, 0.0), 0.0))
        self.contribution = (np.abs(windup) < width).astype(float)
        return push


class _MotorCoupling(Hook):
    """The motor of the neighbouring joint turns this one too: ``inertia`` off the diagonal, and drag.

    Symmetric: joint i feels ``inertia · ddq_j`` and joint j feels ``inertia · ddq_i``.
    """

    def begin(self, s: State) -> None:
        column, joint = np.divmod(self.idx, s.joints)
        self._other = self.idx + np.where(joint > 0, -1, 1)
        pair = np.stack([joint, joint + (self._other - self.idx)], axis=1)
        s.coupling.append((column, pair, self.p["inertia"]))

    def force(self, s: State) -> None:
        drag = self.p["inertia"] * self.p["drag_ratio"]
        s.f_motor[self.idx] -= drag * s.v[self._other]
        s.f_motor[self._other] -= drag * s.v[self.idx]
        self.contribution = self.p["inertia"] * s.acceleration[self._other] + drag * s.v[self._other]


def _encoder_side(rng: np.random.Generator, c: Scale) -> float:
    """Position at the motor (1) or at the load (0); stiff loops are closed at the motor, or they ring."""
    return 1.0 if c.bandwidth > 60.0 else float(rng.integers(2))


EFFECTS = (
    Effect(
        "backlash",
        lambda rng, c: {
            "flank": 4.0e4 * c.armature,
            "damping": 30.0 * c.armature,
            "encoder_at_motor": _encoder_side(rng, c),
        },
        "half_width",
        lambda c, _: (1e-4, 0.05),
        {"half_width": "rad", "flank": "N·m/rad", "damping": "N·m·s/rad", "encoder_at_motor": "1"},
        "at every reversal of the transmitted torque",
        _Backlash,
        needs=("armature",),
    ),
    Effect(
        "joint_elasticity",
        lambda rng, c: {
            "damping": rng.uniform(0.02, 0.1) * np.sqrt(c.torque / 0.01 * c.armature),
            "encoder_at_motor": _encoder_side(rng, c),
        },
        "compliance",
        lambda c, _: (5e-5 / c.torque, 0.15 / c.torque),
        {"compliance": "rad/(N·m)", "damping": "N·m·s/rad", "encoder_at_motor": "1"},
        "with load and acceleration, most at high frequency",
        _Elasticity,
        needs=("armature",),
    ),
    Effect(
        "motor_coupling",
        lambda rng, c: {"drag_ratio": log_uniform(rng, 0.1, 1.0)},
        "inertia",
        lambda c, _: (1e-3 * c.armature, 0.6 * c.armature),
        {"inertia": "kg·m²", "drag_ratio": "1/s"},
        "when the neighbouring joint accelerates",
        _MotorCoupling,
        min_joints=2,
        needs=("armature",),
    ),
)
