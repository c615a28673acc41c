"""A one-joint world with known secrets, for tests and for trying the tool: not MuJoCo, not its time step.

A pendulum under PD control, integrated at 10 kHz with Heun's method and tanh-regularised friction, while the tool
simulates with MuJoCo's implicit integrator and solver friction at 1 kHz: otherwise the tool would be graded
on its own rounding.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

MASS, LENGTH, INERTIA, GRAVITY = 1.2, 0.25, 0.012, 9.81
RATE_HZ, FINE = 1000, 10

MODEL_XML = """<mujoco model="rig">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="elbow" axis="0 1 0" damping="{damping}" frictionloss="{friction}" armature="{armature}"/>
      <inertial mass="{mass}" pos="0 0 -{length}" diaginertia="{inertia} {inertia} 0.001"/>
    </body>
  </worldbody>
</mujoco>
"""


@dataclass
class Secret:
    """What the world does beyond the model; every default means nothing.

    ``friction`` and ``damping`` are also what the model knows; ``extra`` maps catalogue names to numbers.
    """

    friction: float = 0.0
    damping: float = 0.08
    mass_factor: float = 1.0
    extra: dict[str, float] = field(default_factory=dict)

    def get(self, name: str) -> float:
        """Strength of one secret, 0 when absent."""
        return self.extra.get(name, 0.0)


@dataclass(frozen=True)
class Drive:
    """How the world is moved and measured."""

    kp: float = 40.0
    kd: float = 2.0
    duration_s: float = 16.0
    amplitude: float = 1.0
    offset: float = 0.0
    q_lsb: float = 2e-4
    tau_noise: float = 0.01
    process: float = 0.01


def write_model(
    path: Path, friction: float = 0.0, damping: float = 0.08, mass: float = MASS, armature: float = 0.0
) -> Path:
    """The nominal model as MJCF."""
    path.write_text(
        MODEL_XML.format(
            damping=damping, friction=friction, armature=armature, mass=mass, length=LENGTH, inertia=INERTIA
        ),
        encoding="utf-8",
    )
    return path


def simulate(secret: Secret, drive: Drive, motion_seed: int, noise_seed: int) -> dict[str, np.ndarray]:
    """Columns of one recording, 1 kHz."""
    rng = np.random.default_rng(noise_seed)
    n = int(drive.duration_s * RATE_HZ)
    phases = np.random.default_rng(1000 + motion_seed)
    parts = [
        (share * drive.amplitude, 2 * math.pi * f, phases.uniform(0, 2 * math.pi))
        for f, share in ((0.11, 0.5), (0.37, 0.3), (0.9, 0.14), (2.1, 0.06))
    ]
    t = np.arange(n) / RATE_HZ
    q_cmd = drive.offset + np.sum([a * np.sin(w * t + p) for a, w, p in parts], axis=0)
    dq_cmd = np.sum([a * w * np.cos(w * t + p) for a, w, p in parts], axis=0)
    kick = np.zeros(n)
    keep = math.exp(-1.0 / RATE_HZ / 0.2)
    white = rng.normal(size=n) * drive.process * math.sqrt(1 - keep**2)
    for i in range(1, n):
        kick[i] = keep * kick[i - 1] + white[i]
    world = _World(secret, float(q_cmd[0]), float(dq_cmd[0]))
    h = 1.0 / RATE_HZ / FINE
    q, u_log = np.empty(n), np.empty(n)
    for i in range(n):
        q_read = round(world.read() / drive.q_lsb) * drive.q_lsb if drive.q_lsb else world.read()
        u = drive.kp * (q_cmd[i] - q_read) + drive.kd * (dq_cmd[i] - world.v)
        q[i], u_log[i] = q_read, u
        for _ in range(FINE):
            world.step(u, float(kick[i]), h)
    return {
        "t": t, "q.elbow": q, "tau.elbow": u_log + rng.normal(size=n) * drive.tau_noise,
        "q_cmd.elbow": q_cmd, "dq_cmd.elbow": dq_cmd,
    }  # fmt: skip


class _World:
    """Motor (and, with play or a spring, link) state."""

    def __init__(self, secret: Secret, q: float, v: float) -> None:
        self.s = secret
        self.on = {name: value for name, value in secret.extra.items() if value}  # asked for at every step
        self.q = self.link = q
        self.v = self.link_v = v
        self.z = 0.0
        self.t = 0.0
        self.lag = 0.0
        self.queue: list[float] = []
        self.J = (MASS * LENGTH**2 + INERTIA) * secret.mass_factor
        self.G = MASS * GRAVITY * LENGTH * secret.mass_factor
        get = secret.get
        self.level = secret.friction + get("coulomb_friction")
        self.viscous = secret.damping + get("viscous_friction")
        self.inertia = self.J + get("armature") + get("payload") * LENGTH**2
        self.weight, self.tilt = self.G + get("payload") * GRAVITY * LENGTH, get("gravity_tilt")
        self.two = bool(get("backlash") or get("joint_elasticity"))
        self.motor = get("motor_inertia") or 0.02
        self.gap, self.stiffness = get("backlash"), get("joint_elasticity") or 900.0
        self.elastic_damping = get("elastic_damping") or (1.5 if get("joint_elasticity") else 6.0)

    def read(self) -> float:
        s = self.s
        return self.q - s.get("encoder_offset") - s.get("encoder_eccentricity") * math.sin(self.q)

    def step(self, u: float, kick: float, h: float) -> None:
        self.t += h
        u = self._drive(u, h)
        if self.two:
            self._two_masses(u + kick, h)
            return
        a0 = self._acceleration(self.q, self.v, u + kick)
        q1, v1 = self.q + h * self.v, self.v + h * a0
        a1 = self._acceleration(q1, v1, u + kick)
        before = self.q
        self.q += h * 0.5 * (self.v + v1)
        self.v += h * 0.5 * (a0 + a1)
        if "presliding_width" in self.on:
            width = self.on["presliding_width"]
            d = self.q - before
            self.z += d / width - abs(d) / width * self.z

    def _drive(self, u: float, h: float) -> float:
        on = self.on
        if "effort_scale" in on:
            u *= on["effort_scale"]
        if "saturation" in on:
            u = max(-on["saturation"], min(on["saturation"], u))
        if "bandwidth" in on:
            self.lag += h / on["bandwidth"] * (u - self.lag)
            u = self.lag
        if "actuator_delay" in on:
            self.queue.append(u)
            n = int(on["actuator_delay"] / h)
            u = self.queue.pop(0) if len(self.queue) > n else self.queue[0]
        return u

    def _friction(self, v: float, load: float) -> float:
        on, level = self.on, self.level
        if "stribeck" in on:
            level += on["stribeck"] * math.exp(-((v / 0.12) ** 2))
        if "load_dependent_friction" in on:
            level += on["load_dependent_friction"] * abs(load)
        if "asymmetric_coulomb" in on:
            level += on["asymmetric_coulomb"] * (1 if v > 0 else -1)
        if "thermal_drift" in on:
            level += on["thermal_drift"] * (1 - math.exp(-self.t / 6.0))
        force = level * math.tanh(v / 0.004) + self.viscous * v
        if "asymmetric_viscous" in on:
            force += on["asymmetric_viscous"] * abs(v)
        if "presliding" in on:
            force += on["presliding"] * self.z
        return force

    def _field(self, q: float, v: float) -> float:
        on, force = self.on, 0.0
        if "cogging" in on:
            force += on["cogging"] * math.sin(23.0 * q + 0.7)
        if "spring_return" in on:
            force += on["spring_return"] * (q - 0.3)
        if "detent" in on:
            x = (q - 0.35) / 0.05
            force += on["detent"] * x * math.exp(0.5 - 0.5 * x * x)
        if "soft_end_stop" in on:
            force += on["soft_end_stop"] * max(0.0, q - 0.6)
        if "soft_close" in on and q < -0.3 and v < 0:
            force += on["soft_close"] * v
        if "unknown_time" in on:
            force += on["unknown_time"] * math.sin(2 * math.pi * 3.3 * self.t)
        if "unknown_product" in on:
            force += on["unknown_product"] * q * v * abs(v)
        return force

    def _acceleration(self, q: float, v: float, u: float) -> float:
        weight = self.weight * math.sin(q + self.tilt)
        return (u - weight - self._field(q, v) - self._friction(v, weight)) / self.inertia

    def _two_masses(self, u: float, h: float) -> None:
        s, gap, motor = self.s, self.gap, self.motor
        delta = self.q - self.link
        over = delta - max(-gap, min(gap, delta))
        T = self.stiffness * over + (self.elastic_damping * (self.v - self.link_v) if over else 0.0)
        friction = s.friction * math.tanh(self.v / 0.004) + s.damping * self.v
        self.v += h * (u - T - friction) / motor
        self.link_v += h * (T - self.G * math.sin(self.link)) / (self.J - motor)
        self.q += h * self.v
        self.link += h * self.link_v


def write_recording(
    path: Path, columns: dict[str, np.ndarray], drive: Drive, effort: str = "commanded", session: str = "a"
) -> Path:
    """CSV and side file."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*[[f"{x:.7g}" for x in c] for c in columns.values()], strict=True))
    side = {
        "controller": {
            "type": "pd",
            "kp": {"elbow": drive.kp},
            "kd": {"elbow": drive.kd},
            "rate_hz": RATE_HZ,
        },
        "effort": effort,
        "input": "q_cmd",
        "session": session,
    }
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    return path


def write_case(folder: Path, secret: Secret, drive: Drive | None = None, seed: int = 0) -> dict[str, Path]:
    """Model, fit, repeat and held-out recording of one secret world."""
    drive = drive or Drive()
    folder.mkdir(parents=True, exist_ok=True)
    made = {"model": write_model(folder / "model.xml", secret.friction, secret.damping)}
    for name, motion in (("fit", seed), ("repeat", seed), ("holdout", seed + 1)):
        columns = simulate(secret, drive, motion, _noise(seed, name))
        made[name] = write_recording(folder / f"{name}.csv", columns, drive)
    return made


def _noise(seed: int, name: str) -> int:
    return seed * 97 + {"fit": 1, "repeat": 2, "holdout": 3}[name]
