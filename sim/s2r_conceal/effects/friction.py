"""Friction that a Coulomb-plus-viscous model leaves out, and Coulomb and viscous friction themselves.

Sources: Armstrong-Hélouvry, Dupont, Canudas de Wit, "A survey of models, analysis tools and compensation
methods for the control of machines with friction", Automatica 30(7), 1994 (Coulomb, viscous, Stribeck,
asymmetry); Dahl, "A solid friction model", Aerospace Corp. TOR-0158, 1968 (presliding); Bouc 1967 and
Wen, "Method for random vibration of hysteretic systems", J. Eng. Mech. 102, 1976 (hysteresis);
Hamon et al., "Dynamic identification of robots with load-dependent friction", IROS 2010 (load);
Bittencourt and Gunnarsson, "Static friction in a robot joint", JDSMC 134(5), 2012 (temperature).
"""

from __future__ import annotations

import numpy as np

from s2r_conceal.effects.base import Effect, Hook, log_uniform, sign
from s2r_conceal.parameters import Scale
from s2r_conceal.plant import AMBIENT_C, State

SLIDING = 1e-3  # [rad/s] slower than this, friction only holds and shows nothing


class _Coulomb(Hook):
    """``F sign(v)``: the bound grows by ``friction`` in both directions."""

    def friction(self, s: State) -> None:
        s.bound_plus[self.idx] += self.p["friction"]
        s.bound_minus[self.idx] += self.p["friction"]
        self.contribution = self.p["friction"] * np.sign(s.v_motor[self.idx])


class _Viscous(Hook):
    """``b v``."""

    def force(self, s: State) -> None:
        self.contribution = self.p["damping"] * s.v_motor[self.idx]
        s.f_motor[self.idx] -= self.contribution


class _Stribeck(Hook):
    """Bound grows by ``excess exp(−(v/velocity)²)``: a hump at small speed, hence stick-slip."""

    def friction(self, s: State) -> None:
        hump = self.p["excess"] * np.exp(-((s.v_motor[self.idx] / self.p["velocity"]) ** 2))
        s.bound_plus[self.idx] += hump
        s.bound_minus[self.idx] += hump
        self.contribution = hump * (np.abs(s.v_motor[self.idx]) > SLIDING)


class _Presliding(Hook):
    """Dahl: the whole Coulomb bound F is reached only over ``displacement`` s₀ after a reversal.

    ``dz/dt = v/s₀ (1 − z sign v)``, torque ``F z``; integrated exactly per step for constant v.
    """

    order = 90  # takes over the bound that the others have built

    def begin(self, s: State) -> None:
        self._z = np.zeros(self.idx.size)

    def friction(self, s: State) -> None:
        v = s.v_motor[self.idx]
        direction = np.sign(v)
        decay = np.exp(-np.abs(v) * s.h / self.p["displacement"])
        self._z = direction + (self._z - direction) * decay
        bound = np.where(self._z > 0, s.bound_plus[self.idx], s.bound_minus[self.idx])
        s.f_motor[self.idx] -= bound * self._z
        s.bound_plus[self.idx] = s.bound_minus[self.idx] = 0.0
        self.contribution = bound * (direction - self._z) * (np.abs(v) > SLIDING)


class _Asymmetric(Hook):
    """Another friction for positive than for negative motion: Coulomb and viscous part."""

    def friction(self, s: State) -> None:
        self.contribution = np.zeros(self.idx.size)
        v = s.v_motor[self.idx]
        chosen = np.where(self.p["direction"] > 0, v > 0, v < 0)
        s.bound_plus[self.idx] += self.p["coulomb_difference"] * (self.p["direction"] > 0)
        s.bound_minus[self.idx] += self.p["coulomb_difference"] * (self.p["direction"] < 0)
        drag = self.p["coulomb_difference"] * self.p["damping_ratio"] * v * chosen
        s.f_motor[self.idx] -= drag
        self.contribution = drag + self.p["coulomb_difference"] * chosen


class _LoadDependent(Hook):
    """Bound grows by ``coefficient · |torque through the gearbox|``, taken one integrator step late."""

    def friction(self, s: State) -> None:
        extra = self.p["coefficient"] * np.abs(s.load[self.idx])
        s.bound_plus[self.idx] += extra
        s.bound_minus[self.idx] += extra
        self.contribution = extra * (np.abs(s.v_motor[self.idx]) > SLIDING)


class _Thermal(Hook):
    """All friction shrinks as the motor warms: factor ``exp(−per_kelvin (T − 25 °C))``."""

    order = 80

    def friction(self, s: State) -> None:
        factor = np.exp(-self.p["per_kelvin"] * (s.temp[self.idx] - AMBIENT_C))
        _rescale(s, self.idx, factor)
        self.contribution = 1.0 - factor


class _Session(Hook):
    """All friction times ``factor`` in the recordings of another session."""

    order = 80

    def friction(self, s: State) -> None:
        _rescale(s, self.idx, self.p["factor"])
        self.contribution = self.p["factor"] - 1.0


def _rescale(s: State, idx: np.ndarray, factor: np.ndarray) -> None:
    s.bound_plus[idx] *= factor
    s.bound_minus[idx] *= factor
    s.f_motor[idx] -= (factor - 1.0) * s.viscous[idx] * s.v_motor[idx]


class _Hysteresis(Hook):
    """Bouc-Wen torque ``torque · z`` over a transition ``width`` much wider than presliding.

    ``dz/dt = v/width (1 − |z| (shape sign(v z) + 1 − shape))``.
    """

    def begin(self, s: State) -> None:
        self._z = np.zeros(self.idx.size)

    def force(self, s: State) -> None:
        v, shape = s.v_motor[self.idx], self.p["shape"]
        rate = 1.0 - np.abs(self._z) * (shape * np.sign(v * self._z) + 1.0 - shape)
        self._z = self._z + s.h * v / self.p["width"] * rate
        self.contribution = self.p["torque"] * self._z
        s.f_motor[self.idx] -= self.contribution


def _no_shape(rng: np.random.Generator, c: Scale) -> dict[str, float]:
    return {}


def _session_for(values: dict[str, float], role: str) -> dict[str, float]:
    return values if role == "holdout" else values | {"factor": 1.0}


EFFECTS = (
    Effect(
        "coulomb_friction",
        _no_shape,
        "friction",
        lambda c, _: (1e-3 * c.torque, 0.6 * c.torque),
        {"friction": "N·m"},
        "whenever the joint moves, by the sign of its speed",
        _Coulomb,
    ),
    Effect(
        "viscous_friction",
        _no_shape,
        "damping",
        lambda c, _: (1e-3 * c.torque / c.speed, 1.0 * c.torque / c.speed),
        {"damping": "N·m·s/rad"},
        "in proportion to speed",
        _Viscous,
    ),
    Effect(
        "stribeck",
        lambda rng, c: {"velocity": log_uniform(rng, 0.03, 0.15) * c.speed},
        "excess",
        lambda c, _: (2e-3 * c.torque, 0.6 * c.torque),
        {"excess": "N·m", "velocity": "rad/s"},
        "at small speed, both directions",
        _Stribeck,
    ),
    Effect(
        "presliding",
        _no_shape,
        "displacement",
        lambda c, _: (2e-4, 0.06),
        {"displacement": "rad"},
        "at every reversal, over a fixed displacement",
        _Presliding,
        same_as=("hysteresis",),
        needs=("coulomb",),
    ),
    Effect(
        "asymmetric_friction",
        lambda rng, c: {"direction": sign(rng), "damping_ratio": rng.uniform(0.0, 1.0) / c.speed},
        "coulomb_difference",
        lambda c, _: (2e-3 * c.torque, 0.5 * c.torque),
        {"coulomb_difference": "N·m", "damping_ratio": "s/rad", "direction": "1"},
        "in one direction of motion",
        _Asymmetric,
    ),
    Effect(
        "load_dependent_friction",
        _no_shape,
        "coefficient",
        lambda c, _: (2e-3, 0.5),
        {"coefficient": "1"},
        "whenever the joint moves under load",
        _LoadDependent,
    ),
    Effect(
        "thermal_drift",
        _no_shape,
        "per_kelvin",
        lambda c, _: (5e-4, 0.08),
        {"per_kelvin": "1/K"},
        "growing as the motor warms",
        _Thermal,
        needs=("coulomb", "viscous"),
    ),
    Effect(
        "session_friction",
        lambda rng, c: {},
        "factor",
        lambda c, _: (1.01, 2.5),
        {"factor": "1"},
        "in the whole other session",
        _Session,
        needs=("coulomb", "viscous"),
        for_role=_session_for,
    ),
    Effect(
        "hysteresis",
        lambda rng, c: {"width": log_uniform(rng, 0.06, 0.25), "shape": rng.uniform(0.55, 0.95)},
        "torque",
        lambda c, _: (2e-3 * c.torque, 0.5 * c.torque),
        {"torque": "N·m", "width": "rad", "shape": "1"},
        "after every reversal, over a wide angle",
        _Hysteresis,
        same_as=("presliding",),
    ),
)
