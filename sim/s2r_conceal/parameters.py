"""What describes one machine: rigid bodies, motor inertia, friction, controller, sensors, motion.

All arrays are per joint (or per body, one body per joint) in the rig's order; SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

STANDARD_GRAVITY = 9.81  # [m/s²], as in MuJoCo's default option


@dataclass(frozen=True, eq=False)
class Machine:
    """The physics that a rigid-body model file can express.

    Attributes:
        mass: Mass of each link [kg], shape (joints,).
        com: Centre of mass in the link frame [m], shape (joints, 3).
        inertia: Rotational inertia about the centre of mass, link axes [kg·m²], shape (joints, 3, 3).
        armature: Motor inertia seen at the joint [kg·m²], shape (joints,).
        viscous: Viscous friction [N·m·s/rad], shape (joints,).
        coulomb: Coulomb friction [N·m], shape (joints,).
        gravity: Acceleration of gravity in the world frame [m/s²], shape (3,).
    """

    mass: np.ndarray
    com: np.ndarray
    inertia: np.ndarray
    armature: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    gravity: np.ndarray

    def with_point_mass(self, body: int, mass_kg: float, p_m: np.ndarray) -> Machine:
        """The same machine carrying a point mass at ``p_m`` in the frame of ``body``."""
        total = self.mass[body] + mass_kg
        com = (self.mass[body] * self.com[body] + mass_kg * p_m) / total
        inertia = (
            self.inertia[body]
            + self.mass[body] * _steiner(self.com[body] - com)
            + mass_kg * _steiner(p_m - com)
        )
        masses, coms, inertias = self.mass.copy(), self.com.copy(), self.inertia.copy()
        masses[body], coms[body], inertias[body] = total, com, inertia
        return replace(self, mass=masses, com=coms, inertia=inertias)


def _steiner(d: np.ndarray) -> np.ndarray:
    """Parallel-axis term per unit mass for an offset ``d``, shape (3, 3)."""
    return float(d @ d) * np.eye(3) - np.outer(d, d)


@dataclass(frozen=True, eq=False)
class Controller:
    """Joint-space PID with feed-forward, one gain per joint.

    ``u = kp (q_cmd − q_meas) + kd (dq_cmd − dq_meas) + ki ∫(q_cmd − q_meas) dt + tau_ff``, computed at
    ``rate_hz`` and held in between; the integral starts at zero with the recording.
    """

    kp: np.ndarray
    kd: np.ndarray
    ki: np.ndarray
    rate_hz: float = 1000.0


@dataclass(frozen=True, eq=False)
class Sensing:
    """What separates two runs of the same motion: the repeatability floor comes from here.

    Attributes:
        lsb: Encoder step [rad], shape (joints,).
        q_noise: White noise before quantisation, standard deviation [rad], shape (joints,).
        dq_noise: White noise of the velocity signal, standard deviation [rad/s], shape (joints,).
        tau_noise: White noise of a measured effort, standard deviation [N·m], shape (joints,).
        process: Standard deviation of the correlated disturbing torque [N·m], shape (joints,).
        process_s: Its correlation time [s] (Ornstein-Uhlenbeck).
    """

    lsb: np.ndarray
    q_noise: np.ndarray
    dq_noise: np.ndarray
    tau_noise: np.ndarray
    process: np.ndarray
    process_s: float


@dataclass(frozen=True, eq=False)
class Heating:
    """Motor temperature: ``dT/dt = (rise (u/u_typical)² − (T − 25 °C)) / time_s`` [K], per joint."""

    rise_K: np.ndarray
    u_typical: np.ndarray
    time_s: float


@dataclass(frozen=True, eq=False)
class Motion:
    """What the controller is told, one row per control tick, shape (ticks, joints)."""

    q_cmd: np.ndarray
    dq_cmd: np.ndarray
    tau_ff: np.ndarray


@dataclass(frozen=True, eq=False)
class Scale:
    """How large things are on one joint, so that effects can be drawn in proportion.

    Attributes:
        torque: Typical (root mean square) torque of the motion [N·m].
        gravity: Largest gravity torque met [N·m].
        inertia: Mean inertia seen by the joint, armature included [kg·m²].
        armature: Motor inertia [kg·m²].
        coulomb: Coulomb friction present in the machine [N·m].
        viscous: Viscous friction present in the machine [N·m·s/rad].
        speed: Typical (root mean square) speed [rad/s].
        speed_max: Largest commanded speed [rad/s].
        torque_max: Largest torque [N·m].
        q_lo, q_hi: Range of the motion [rad].
        bandwidth: Closed-loop bandwidth [rad/s].
        duration_s: Length of a recording [s].
    """

    torque: float
    gravity: float
    inertia: float
    armature: float
    coulomb: float
    viscous: float
    speed: float
    speed_max: float
    torque_max: float
    q_lo: float
    q_hi: float
    bandwidth: float
    duration_s: float
