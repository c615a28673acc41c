"""Forward simulation in MuJoCo: closed loop with the declared controller inside, or open loop from the record."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Context, Runtime, StepState
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.servo import servo_of, ticks_of
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.nuisance import BaseParameter
from s2r_host.gap.simulation.generic import forms
from s2r_host.gap.simulation.polish import FRICTION_EFFECTS

MAX_STEP_S = 0.00025
HARD_SOLREF, HARD_SOLIMP = (0.001, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)  # dry friction that does not creep
DRIVE = ("actuator_delay", "bandwidth", "saturation")


@dataclass(frozen=True)
class Live:
    """One effect with numbers: what the forward simulation and the patch are made from."""

    effect: str
    joint: int
    shape: dict[str, float]
    theta: np.ndarray


@dataclass
class Twin:
    """A model with effects in it, ready to run.

    Attributes:
        spec: Source with every stock attribute written; ``model`` its compilation.
        live: Effects that need a callback, and the generic correction of what has no name.
        at_link: Joints whose encoder is behind their gear: it sees the joint and what an effect put behind it together.
        lag: Sensor lag per joint [s].
        learned: Effort per joint that a baseline takes away; it is not part of what is written.
        friction_factor: All friction of a session over that of the fitted ones, by its label, shape (joint,).
    """

    rigid: RigidModel
    ctx: Context
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    native: list[Live] = field(default_factory=list)
    live: list[Live] = field(default_factory=list)
    sensors: dict[int, Callable[[float], float]] = field(default_factory=dict)
    at_link: set[int] = field(default_factory=set)
    lag: dict[int, float] = field(default_factory=dict)
    offset: np.ndarray = field(default_factory=lambda: np.zeros(0))
    learned: Callable[[StepState], np.ndarray] | None = None
    friction_factor: dict[str, np.ndarray] = field(default_factory=dict)


def build_twin(
    rigid: RigidModel, ctx: Context, terms: list[Live],
    base: list[tuple[BaseParameter, float]] | None = None,
    learned: Callable[[StepState], np.ndarray] | None = None,
) -> Twin:  # fmt: skip
    """Write base parameters and effects into a copy of the model; what has no stock form stays live."""
    spec = rigid.spec.copy()
    offset = np.zeros(len(rigid.joints))
    for parameter, value in base or []:
        if parameter.name == "effort_offset":
            offset[rigid.index(parameter.place)] += value
        parameter.write(spec, value)
    twin = Twin(rigid, ctx, spec, rigid.model, offset=offset, learned=learned)
    for term in [*terms, *_mirrored(terms)]:
        effect = forms().get(term.effect)
        if effect is None:
            continue
        sense = effect.sense(ctx, term.joint, term.shape, term.theta)
        if sense is not None:
            twin.sensors[term.joint] = sense
        elif term.effect == "clock_skew":
            twin.lag[term.joint] = term.shape["lag"]
        elif effect.patch(ctx, spec, term.joint, term.shape, term.theta):
            twin.native.append(term)
            if "at_link" in term.shape:
                twin.at_link.add(term.joint)
        else:
            twin.live.append(term)
    twin.model = spec.compile()
    return twin


def _mirrored(terms: list[Live]) -> list[Live]:
    found = []
    for term in terms:
        effect = forms().get(term.effect)
        other = None if effect is None else effect.mirror(term.joint, term.shape)
        if other is not None:
            found.append(Live(term.effect, *other, term.theta))
    return found


@dataclass(frozen=True)
class Run:
    """Simulated motion and effort on the work grid, shape (time, joint)."""

    q: np.ndarray
    u: np.ndarray
    finite: bool


def run(twin: Twin, s: Session, start: int, stop: int, closed: bool) -> Run:
    """Simulate samples ``start`` to ``stop`` of a session from the recorded state at ``start``.

    Args:
        twin: Model with effects.
        s: The recording to follow: its commands (closed loop) or its efforts (open loop).
        start: First sample on the work grid; ``stop`` is one past the last.
        closed: Controller inside the simulation; else the recorded effort drives it.
    """
    plan = _Plan(twin, s, closed)
    n, nv = stop - start, len(twin.rigid.joints)
    q_out, u_out = np.zeros((n, nv)), np.zeros((n, nv))
    plan.reset(start)
    for i in range(n):
        q_out[i] = plan.measure()
        for k in range(plan.ticks):
            u = plan.control((start + i) * plan.ticks + k)
            if k == 0:
                u_out[i] = u
            plan.advance()
        if not np.isfinite(plan.qpos).all() or np.abs(plan.qvel).max() > 1e4:
            q_out[i + 1 :] = np.nan
            return Run(q_out, u_out, False)
    for joint, lag in twin.lag.items():
        grid = np.arange(n) * s.dt
        q_out[:, joint] = np.interp(grid - lag, grid, q_out[:, joint])
    return Run(q_out, u_out, True)


class _Plan:
    """Everything one simulation needs, precomputed."""

    def __init__(self, twin: Twin, s: Session, closed: bool) -> None:
        self.twin, self.s, self.closed = twin, s, closed
        m = self.model = copy.copy(twin.model)
        # The law runs at its own rate between the rows that were kept; time steps divide its period.
        self.ticks = ticks_of(s) if closed else 1
        self.substeps = max(1, int(np.ceil(s.dt / self.ticks / min(m.opt.timestep, MAX_STEP_S) - 1e-9)))
        m.opt.timestep = self.tick_s = s.dt / self.ticks
        m.opt.timestep /= self.substeps
        m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        self.data = mujoco.MjData(m)
        # MuJoCo makes an array of each of them anew whenever it is asked.
        self.qpos, self.qvel, self.qacc = self.data.qpos, self.data.qvel, self.data.qacc
        self.applied, self.constraint = self.data.qfrc_applied, self.data.qfrc_constraint
        self.dry = m.dof_frictionloss
        names = [m.joint(i).name for i in range(m.njnt)]
        self.dof = np.array([int(m.jnt_dofadr[names.index(j)]) for j in twin.rigid.joints])
        self.adr = np.array([int(m.jnt_qposadr[names.index(j)]) for j in twin.rigid.joints])
        hard = self.dof[s.lead == 0.0]  # else the recorded friction is that of MuJoCo
        m.dof_solref[hard], m.dof_solimp[hard] = HARD_SOLREF, HARD_SOLIMP
        self.friction = np.array(m.dof_frictionloss[self.dof])
        factor = twin.friction_factor.get(s.rec.session, np.ones(len(self.dof)))
        self.friction *= factor
        m.dof_damping[self.dof] *= factor
        m.dof_frictionloss[self.dof] = np.maximum(self.friction, 0.0)
        own = set(self.dof.tolist())
        self.flex = [(dof, j) for j, d in enumerate(self.dof) for dof in _behind(m, int(d)) if dof not in own]
        self.behind = [
            (joint, dof, int(m.jnt_qposadr[m.dof_jntid[dof]]))
            for dof, joint in self.flex
            if joint in twin.at_link
        ]
        self.laws = [
            servo_of(twin.rigid, s, j, self.ticks) if closed else None for j in range(len(twin.rigid.joints))
        ]
        self.pushed = np.repeat(s.pushed, self.ticks, axis=0)
        self.u_rec = np.repeat(np.nan_to_num(s.u), self.ticks, axis=0) - self.pushed
        self.limits = twin.rigid.effort_limits()
        h = m.opt.timestep
        effects = forms()
        self.h = h
        arrived = not closed and s.rec.effort == "measured"  # a measured effort has passed the drive
        self.make: Callable[[], list[tuple[int, Runtime]]] = lambda: [
            (
                max(t.joint, 0),
                _scaled(r, float(factor[max(t.joint, 0)]) if t.effect in FRICTION_EFFECTS else 1.0),
            )
            for t in twin.live
            if not (arrived and t.effect in DRIVE)
            and (r := effects[t.effect].runtime(twin.ctx, t.joint, t.shape, t.theta, h)) is not None
        ]
        self.runtimes: list[tuple[int, Runtime]] = []
        self.integral = np.zeros(len(self.dof))
        self.u, self.push = np.zeros(len(self.dof)), np.zeros(len(self.dof))
        self.load = np.zeros(len(self.dof))
        self.now = 0.0

    def reset(self, start: int) -> None:
        d, s = self.data, self.s
        mujoco.mj_resetData(self.model, d)
        q = s.q[start].copy()
        for joint, sense in self.twin.sensors.items():
            q[joint] += q[joint] - sense(q[joint])
        d.qpos[self.adr], d.qvel[self.dof] = q, s.v[start]
        d.qvel[self.dof] /= self.slopes(q)
        self.runtimes = self.make()
        self.load = s.load[start].copy()
        self.now = float(s.t[start])
        self.integral[:] = 0.0
        for j, law in enumerate(self.laws):
            if law is not None and law.ki and s.has_drive[j]:
                self.integral[j] = law.integral(s, j, start)

    def measure(self) -> np.ndarray:
        q = self.qpos[self.adr]
        for joint, _, adr in self.behind:
            q[joint] += self.qpos[adr]
        for joint, sense in self.twin.sensors.items():
            q[joint] = sense(float(q[joint]))
        return q

    def slopes(self, q: np.ndarray) -> np.ndarray:
        """Recorded over true speed of each joint, shape (joint,)."""
        out = np.ones(len(q))
        for joint, sense in self.twin.sensors.items():
            x = float(q[joint])
            out[joint] = (sense(x + 1e-4) - sense(x - 1e-4)) / 2e-4
        return out

    def control(self, i: int) -> np.ndarray:
        q, v = self.measure(), self.qvel[self.dof]
        for joint, dof, _ in self.behind:
            v[joint] += self.qvel[dof]
        if self.twin.sensors:
            v = v * self.slopes(self.qpos[self.adr])
        for j, law in enumerate(self.laws):
            if law is None:
                self.u[j] = self.u_rec[i, j]
                continue
            self.u[j] = law.without_integral(i, q[j], v[j])
            if law.ki:
                self.integral[j] += (law.q_cmd[i] - q[j]) * self.tick_s
                self.u[j] += law.ki * self.integral[j]
        low, high = self.limits
        np.minimum(np.maximum(self.u, low, out=self.u), high, out=self.u)
        self.push = self.pushed[i]
        return self.u + self.push

    def advance(self) -> None:
        """One tick of the law: its effort stays, what depends on the motion is looked at in every step."""
        if self.runtimes or self.twin.learned is not None:
            for _ in range(self.substeps):
                self.step()
            return
        self.apply(self.u + self.push - self.twin.offset)
        mujoco.mj_step(self.model, self.data, self.substeps)

    def step(self) -> None:
        """One time step with the effects that are live."""
        force = self.u + self.push - self.twin.offset
        state = StepState(
            self.now,
            self.qpos[self.adr],
            self.qvel[self.dof],
            self.qacc[self.dof],
            self.u,
            self.push,
            self.load,
        )
        if self.runtimes:
            dry = self.friction.copy()
            for joint, runtime in self.runtimes:
                taken, level = runtime(state)
                force[joint] -= taken
                dry[joint] += level
            self.dry[self.dof] = np.maximum(dry, 0.0)
        if self.twin.learned is not None:
            force = force - self.twin.learned(state)
        self.apply(force)
        mujoco.mj_step(self.model, self.data)
        self.load = force + self.constraint[self.dof]
        self.now += self.h

    def apply(self, force: np.ndarray) -> None:
        """Efforts of the joints; a wrench acts on the link, which may be behind a gear."""
        self.applied[self.dof] = force
        for dof, joint in self.flex:
            self.applied[dof] = self.push[joint]


def _behind(model: mujoco.MjModel, dof: int) -> list[int]:
    """Degrees of freedom of coincident joints that an effect has put behind that of a motor."""
    motor = int(model.dof_jntid[dof])
    same = (
        j
        for j in range(motor + 1, model.njnt)
        if model.jnt_bodyid[j] == model.jnt_bodyid[motor]
        and model.jnt_type[j] == model.jnt_type[motor]
        and np.allclose(model.jnt_axis[j], model.jnt_axis[motor])
        and np.allclose(model.jnt_pos[j], model.jnt_pos[motor])
    )
    return [int(model.jnt_dofadr[j]) for j in same]


def _scaled(runtime: Runtime, factor: float) -> Runtime:
    """The same effect, all its efforts times a factor."""
    if factor == 1.0:
        return runtime

    def step(state: StepState) -> tuple[float, float]:
        taken, level = runtime(state)
        return factor * taken, factor * level

    return step


def has_loop(rigid: RigidModel, s: Session) -> bool:
    """Is the controller of at least one joint known, so that a closed loop can be simulated?"""
    return any(servo_of(rigid, s, j) is not None for j in range(len(rigid.joints)))


def windows(s: Session, length_s: float) -> list[tuple[int, int]]:
    """Consecutive windows of a session, (start, stop) in samples; edges of the record are left out."""
    n = max(int(length_s / s.dt), 20)
    margin = max(2, min(int(0.1 / s.dt), len(s.t) // 20))
    starts = range(margin, max(len(s.t) - margin - n // 2, margin + 1), n)
    return [(a, min(a + n, len(s.t) - margin)) for a in starts]
