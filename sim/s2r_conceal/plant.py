"""The machine of the concealed recordings: many columns side by side, 10 kHz, friction as a true set-valued law.

A column is one recording of one machine.  State arrays are flat over (column, joint), so an effect holds the
flat indices it lives on and never knows which rig it is in.

Time stepping is Moreau-Jean: velocities by semi-implicit (symplectic) Euler, dry friction as an impulse that
may reach but not pass its bound, solved exactly on one joint and by projected Gauss-Seidel on several
(Moreau 1988, "Unilateral contact and dry friction in finite freedom dynamics"; Jean 1999, "The non-smooth
contact dynamics method").  Nothing is smoothed by a tanh and nothing creeps, unlike in a simulator that
regularises friction as a soft constraint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.signal import lfilter

from s2r_conceal.motions import RATE_HZ
from s2r_conceal.parameters import Controller, Heating, Machine, Motion, Sensing
from s2r_conceal.rigs.base import Rig

SUBSTEPS = 10  # integrator steps per control tick: 10 kHz
SETTLE_TICKS = 500  # rest before the recording starts, integral off
AMBIENT_C = 25.0


@dataclass(frozen=True)
class Active:
    """One effect at work in one column: its name, the joint it sits on, its parameters (SI)."""

    name: str
    joint: int
    values: dict[str, float]


@dataclass(frozen=True, eq=False)
class Column:
    """One recording to simulate. ``noise`` seeds the disturbances; None means none and no quantisation."""

    machine: Machine
    controller: Controller
    motion: Motion
    sensing: Sensing
    heating: Heating
    effects: tuple[Active, ...] = ()
    noise: tuple[int, ...] | None = None


@dataclass(eq=False)
class Trace:
    """What one column did, one row per control tick, shape (ticks, joints) unless said otherwise.

    Attributes:
        q, dq: Measured position and velocity, as the controller saw them.
        tau_commanded: What the controller asked for.
        tau_measured: What the drive reports: after delay, lag and clip, before a wrong torque constant.
        temp_C: Motor temperature.
        contributions: Per effect of the column, in order, the size of its contribution, shape (ticks,).
        lsb: Encoder step, shape (joints,); None of a run without noise and quantisation.
    """

    q: np.ndarray
    dq: np.ndarray
    tau_commanded: np.ndarray
    tau_measured: np.ndarray
    temp_C: np.ndarray
    contributions: list[np.ndarray] = field(default_factory=list)
    lsb: np.ndarray | None = None


class Hook(Protocol):
    """One kind of effect on all the flat indices it lives on; see ``effects.base``."""

    contribution: np.ndarray
    idx: np.ndarray
    owners: list[tuple[int, int]]


class MotorSide(Protocol):
    """A motor that turns at its own speed behind a compliant transmission."""

    speed: np.ndarray


class State:
    """Everything the effects may read or change. Flat arrays of length columns × joints.

    Attributes:
        q, v: Joint position and velocity on the load side.
        v_motor: Velocity on the motor side; differs from ``v`` only behind a compliant transmission.
        u: Commanded effort, held over the control tick.
        u_drive: Effort that reaches the motor; drive effects change it.
        u_report: Effort the drive reports.
        f_motor, f_link: Forces on either side of the transmission, cleared every step.
        bound_plus, bound_minus: Dry friction bound for motion in either direction, set every step.
        inertia_extra: Additional inertia on the diagonal, cleared every step.
        load: Torque through the gearbox in the step before [N·m].
        acceleration: Load-side acceleration in the step before.
        temp: Motor temperature [°C].
        t: Time since the recording began [s]; h: integrator step [s]; tick: control tick.
    """

    def __init__(self, columns: Sequence[Column], h: float) -> None:
        def flat(values: list[np.ndarray]) -> np.ndarray:
            return np.concatenate([np.asarray(v, float) for v in values])

        self.columns = len(columns)
        self.joints = len(columns[0].machine.mass)
        self.h, self.t, self.tick = h, 0.0, 0
        self.armature = flat([c.machine.armature for c in columns])
        self.viscous = flat([c.machine.viscous for c in columns])
        self.coulomb = flat([c.machine.coulomb for c in columns])
        self.q = flat([c.motion.q_cmd[0] for c in columns])
        n = self.q.size
        self.v, self.u, self.u_drive, self.u_report = (np.zeros(n) for _ in range(4))
        self.f_motor, self.f_link, self.inertia_extra = np.zeros(n), np.zeros(n), np.zeros(n)
        self.load, self.acceleration, self.impulse = np.zeros(n), np.zeros(n), np.zeros(n)
        self.bound_plus, self.bound_minus = self.coulomb.copy(), self.coulomb.copy()
        self.v_motor = self.v
        self.temp = np.full(n, AMBIENT_C)
        self.rigid = np.ones(n, bool)
        self.transmissions: list[tuple[np.ndarray, MotorSide]] = []
        self.coupling: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []


def simulate(rig: Rig, columns: Sequence[Column], substeps: int = SUBSTEPS) -> list[Trace]:
    """Simulate all columns over the whole motion.

    Args:
        rig: The rig all columns share.
        columns: One recording each; all motions equally long.
        substeps: Integrator steps per control tick of 1 ms.
    """
    from s2r_conceal.effects.table import build_hooks  # effects know the state, the plant knows only hooks

    plant = _Plant(rig, columns, substeps)
    plant.hooks = build_hooks(columns, plant.state)
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable column ends as inf; the caller looks
        return plant.run()


class _Plant:
    def __init__(self, rig: Rig, columns: Sequence[Column], substeps: int) -> None:
        from s2r_conceal.effects.table import altered_machine

        self.columns, self.substeps, self.joints = columns, substeps, rig.joints
        machines = [altered_machine(rig, c.machine, c.effects) for c in columns]
        self.state = State(columns, 1.0 / RATE_HZ / substeps)
        self.state.armature = np.concatenate([m.armature for m in machines])
        self.dynamics = rig.dynamics(machines)
        self.ticks = len(columns[0].motion.q_cmd)
        self.hooks: list = []
        unique = list({id(c.motion): c.motion for c in columns}.values())
        place = {id(m): k for k, m in enumerate(unique)}
        self._which = np.array([place[id(c.motion)] for c in columns])
        self._commands = np.stack(
            [np.stack([m.q_cmd, m.dq_cmd, m.tau_ff], axis=1) for m in unique], axis=1
        )  # (ticks, motions, 3, joints)
        self._kp, self._kd, self._ki = (
            np.concatenate([getattr(c.controller, k) for c in columns]) for k in ("kp", "kd", "ki")
        )
        self._noise = _Noise(columns, self.ticks)
        self._rise = np.concatenate([c.heating.rise_K / c.heating.u_typical**2 for c in columns])
        self._cool_s = np.repeat([c.heating.time_s for c in columns], self.joints)
        self._shape = (len(columns), self.joints)
        self._steps = 0

    # -- the loop ---------------------------------------------------------------------------------

    def run(self) -> list[Trace]:
        s, n = self.state, self.state.q.size
        integral = np.zeros(n)
        logs = np.zeros((5, self.ticks, n), np.float32)
        contributions = [np.zeros((self.ticks, hook.idx.size), np.float32) for hook in self.hooks]
        stages = self._stages()
        for tick in range(-SETTLE_TICKS, self.ticks):
            row = max(tick, 0)
            s.tick, s.t = row, tick / RATE_HZ
            q_cmd, dq_cmd, tau_ff = (self._commands[row, self._which, k].reshape(n) for k in range(3))
            if tick < 0:
                dq_cmd = np.zeros(n)
            q_meas, dq_meas = self._measure(row, stages["sense"])
            error = q_cmd - q_meas
            if tick >= 0:
                integral += error / RATE_HZ
            s.u = self._kp * error + self._kd * (dq_cmd - dq_meas) + self._ki * integral + tau_ff
            process = self._noise.process(row)
            for sub in range(self.substeps):
                self._step(stages, process)
                if sub == 0 and tick >= 0:
                    reported = s.u_report + self._noise.tau[row]
                    logs[:, tick] = q_meas, dq_meas, s.u, reported, s.temp
                    for hook, log in zip(self.hooks, contributions, strict=True):
                        log[tick] = hook.contribution
                s.t += s.h
            s.temp += (self._rise * s.u_drive**2 - (s.temp - AMBIENT_C)) / self._cool_s / RATE_HZ
        return self._traces(logs, contributions)

    def _stages(self) -> dict[str, list]:
        """Bound methods of the hooks, by stage, in the hooks' order."""
        names = ("drive", "force", "friction", "transmit", "sense")
        return {name: [getattr(h, name) for h in self.hooks if hasattr(h, name)] for name in names}

    def _measure(self, row: int, sense: list) -> tuple[np.ndarray, np.ndarray]:
        s = self.state
        q, dq = s.q.copy(), s.v + self._noise.dq[row]
        for hook in sense:
            hook(s, q, dq)
        return self._noise.encode(q, row), dq

    def _step(self, stages: dict[str, list], process: np.ndarray) -> None:
        s, h = self.state, self.state.h
        s.u_drive = s.u.copy()
        s.u_report = s.u_drive
        for hook in stages["drive"]:
            hook(s)
        s.f_motor[:] = 0.0
        s.f_link[:] = process
        s.inertia_extra[:] = 0.0
        for hook in stages["force"]:
            hook(s)
        s.bound_plus[:] = s.coulomb
        s.bound_minus[:] = s.coulomb
        for hook in stages["friction"]:
            hook(s)
        motor = s.u_drive + s.f_motor - s.viscous * s.v_motor
        for hook in stages["transmit"]:
            hook(s, motor)
        self._advance(motor, h)

    def _advance(self, motor: np.ndarray, h: float) -> None:
        """One Moreau-Jean step of the load side; ``motor`` is the torque arriving through the transmission."""
        s = self.state
        before = s.v
        diagonal = s.armature * s.rigid + s.inertia_extra
        if self.joints == 1:
            link, bias = self._one_joint()
            inertia = link + diagonal
            free = before + h / inertia * (motor + s.f_link - bias)
            low, high = -s.bound_minus * (h / inertia), s.bound_plus * (h / inertia)
            friction = np.minimum(np.maximum(free, low), high)
            v = free - friction
            s.impulse = friction * inertia / h
        else:
            bias, v = self._several_joints(motor, diagonal, h)
        s.acceleration = (v - before) / h
        s.load = motor - s.impulse - s.armature * s.rigid * s.acceleration
        s.v = s.v_motor = v
        if s.transmissions:
            s.v_motor = v.copy()
            for idx, motor_side in s.transmissions:
                s.v_motor[idx] = motor_side.speed
        s.q = s.q + h * v

    def _one_joint(self) -> tuple[np.ndarray, np.ndarray]:
        s = self.state
        q, v = s.q[:, None], s.v[:, None]
        return self.dynamics.mass_matrix(q)[:, 0, 0], self.dynamics.bias(q, v)[:, 0]

    def _several_joints(
        self, motor: np.ndarray, diagonal: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        s, shape = self.state, self._shape
        mass, bias = self._extrapolated(s.q.reshape(shape), s.v.reshape(shape))
        mass = mass.copy()
        joints = np.arange(self.joints)
        mass[:, joints, joints] += diagonal.reshape(shape)
        for column, pair, inertia in s.coupling:
            mass[column, pair[:, 0], pair[:, 1]] += inertia
            mass[column, pair[:, 1], pair[:, 0]] += inertia
        inverse = np.linalg.inv(mass)
        torque = (motor + s.f_link).reshape(shape) - bias
        impulse = s.impulse.reshape(shape) * h
        v = s.v.reshape(shape) + np.einsum("cij,cj->ci", inverse, h * torque - impulse)
        low, high = -h * s.bound_minus.reshape(shape), h * s.bound_plus.reshape(shape)
        for _ in range(3):  # projected Gauss-Seidel, warm-started with the impulses of the step before
            for i in range(self.joints):
                wanted = impulse[:, i] + v[:, i] / inverse[:, i, i]
                change = np.minimum(np.maximum(wanted, low[:, i]), high[:, i]) - impulse[:, i]
                impulse[:, i] += change
                v = v - inverse[:, :, i] * change[:, None]
        s.impulse = (impulse / h).reshape(-1)
        return bias.reshape(-1), v.reshape(-1)

    def _extrapolated(self, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inertia and bias, evaluated every ``refresh_every`` steps and continued linearly in between."""
        every = self.dynamics.refresh_every
        phase = self._steps % every
        if phase == 0:
            mass, bias = self.dynamics.mass_matrix(q), self.dynamics.bias(q, dq)
            first = self._steps == 0
            self._slopes = (
                np.zeros_like(mass) if first else (mass - self._mass) / every,
                np.zeros_like(bias) if first else (bias - self._bias) / every,
            )
            self._mass, self._bias = mass, bias
        self._steps += 1
        if every == 1:
            return self._mass, self._bias
        return self._mass + phase * self._slopes[0], self._bias + phase * self._slopes[1]

    def _traces(self, logs: np.ndarray, contributions: list[np.ndarray]) -> list[Trace]:
        traces = []
        for c in range(len(self.columns)):
            part = slice(c * self.joints, (c + 1) * self.joints)
            q, dq, asked, reported, temp = (np.ascontiguousarray(log[:, part]) for log in logs)
            traces.append(Trace(q, dq, asked, reported, temp))
            traces[c].contributions = [np.zeros(0, np.float32)] * len(self.columns[c].effects)
            traces[c].lsb = None if self.columns[c].noise is None else self.columns[c].sensing.lsb
        for hook, log in zip(self.hooks, contributions, strict=True):
            for k, (column, position) in enumerate(hook.owners):
                traces[column].contributions[position] = log[:, k]
        return traces


class _Noise:
    """Disturbances of every column, drawn before the run from the column's own seed."""

    _PROCESS_EVERY = 4  # ticks between two values of the disturbing torque; linear in between

    def __init__(self, columns: Sequence[Column], ticks: int) -> None:
        joints = len(columns[0].machine.mass)
        n = len(columns) * joints
        self.dq = np.zeros((ticks, n), np.float32)
        self.tau = np.zeros((ticks, n), np.float32)
        self._q = np.zeros((ticks, n), np.float32)
        self._process = np.zeros((ticks // self._PROCESS_EVERY + 2, n))
        self._lsb = np.ones(n)
        self._quantised = np.zeros(n, bool)
        for c, column in enumerate(columns):
            if column.noise is not None:
                self._fill(column, np.random.default_rng(column.noise), slice(c * joints, (c + 1) * joints))
        self._any = bool(self._quantised.any())

    def _fill(self, column: Column, rng: np.random.Generator, part: slice) -> None:
        sensing, joints = column.sensing, part.stop - part.start
        for array, size in (
            (self._q, sensing.q_noise),
            (self.dq, sensing.dq_noise),
            (self.tau, sensing.tau_noise),
        ):
            array[:, part] = rng.standard_normal((len(array), joints), np.float32) * size
        keep = np.exp(-self._PROCESS_EVERY / RATE_HZ / sensing.process_s)
        kicks = rng.standard_normal((len(self._process), joints)) * sensing.process
        kicks[1:] *= np.sqrt(1.0 - keep**2)
        walk = lfilter([1.0], [1.0, -keep], kicks, axis=0)
        self._process[:, part] = walk
        self._lsb[part] = sensing.lsb
        self._quantised[part] = True

    def process(self, row: int) -> np.ndarray:
        """Disturbing torque at a tick [N·m]."""
        k, rest = divmod(row, self._PROCESS_EVERY)
        w = rest / self._PROCESS_EVERY
        return (1.0 - w) * self._process[k] + w * self._process[k + 1]

    def encode(self, q: np.ndarray, row: int) -> np.ndarray:
        """Encoder noise and quantisation of the columns that have them."""
        if not self._any:
            return q
        counts = np.rint((q + self._q[row]) / self._lsb) * self._lsb
        return np.where(self._quantised, counts, q)
