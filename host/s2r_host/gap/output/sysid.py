"""The user's own parameters, fitted by MuJoCo's own toolbox ``mujoco.sysid``: a baseline without new physics.

The toolbox rolls a model out under its controls and has no control law around it, so the recordings go in as open-loop
windows: the recorded effort drives one motor per joint, and the measured positions are what is to be met.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np
from mujoco import sysid

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.neutral import plain_motor
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.base_terms import NEVER_NEGATIVE
from s2r_host.gap.regression.nuisance import BaseParameter
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.simulation.forward import first_held
from s2r_host.gap.simulation.replay import HARD_SOLIMP, HARD_SOLREF, windows

LIMIT_S = 40.0  # of processor time, so that the answer does not depend on what else the machine does
ITERATIONS = 12
WINDOW_S, WINDOWS = 2.0, 10
STEP_S = 0.001
BOUND = 30.0  # times what a nominal value usually errs by
LEAST_LEFT = 0.05  # of a mass, an inertia or a friction
DIFFERENCE = 1e-4  # of a parameter's size, for the derivatives
LOST = 10.0  # rad or m: where a simulation left the world
MOTOR = "identified:"


@dataclass(frozen=True)
class Identified:
    """What the toolbox found.

    Attributes:
        moved: Parameters with their change in units of their size.
        windows: How many stretches of recordings it was fitted to.
        cut_off: Whether it was stopped by ``LIMIT_S`` of processor time.
    """

    moved: list[tuple[BaseParameter, float]]
    windows: int
    cut_off: bool

    def as_json(self) -> dict:
        """What was fitted to what, and the values found."""
        cut = f"; cut off after {LIMIT_S:g} s of processor time, the best so far" if self.cut_off else ""
        return {
            "how": f"mujoco.sysid: {len(self.moved)} numbers of the model, within bounds, on {self.windows} open-loop "
            f"windows of {WINDOW_S:g} s of the fitted recordings, no new physics{cut}",
            "parameters": [
                {
                    "name": p.name, "joint" if p.on_joint else "body": p.place, "from": p.nominal,
                    "to": p.nominal + x * p.size, "unit": p.unit,
                }
                for p, x in self.moved
            ],
        }  # fmt: skip


class _OutOfTimeError(Exception):
    """The limit has passed."""


def missing_parts() -> str | None:
    """Why ``mujoco.sysid`` cannot be used, None where it can: it imports as an empty module without its extras."""
    if hasattr(sysid, "optimize"):
        return None
    return "mujoco.sysid lacks packages that it needs: pip install 'mujoco[sysid]'"


def identify(
    problem: Problem, fit: list[Session], held_apart: bool, *, limit_s: float = LIMIT_S
) -> Identified | str:
    """Fit what is a number of the user's model: masses, centres, inertias, friction, damping, motor inertias, offsets.

    Args:
        problem: Says which parameters the model has and how far they usually err.
        fit: Recordings that may be fitted to.
        held_apart: Whether others are held out; else the last part of each is left alone.
        limit_s: Processor time after which the best so far is returned [s].

    Returns:
        What was found, or a sentence that says why nothing can be.
    """
    why = missing_parts()
    if why is not None:
        return why
    if not all(s.has_u.all() for s in fit):
        return "an open-loop run needs an effort of every joint"
    model = problem.ctx.model
    pieces = _pieces(fit, held_apart)
    if not any(own for _, own in pieces):
        return f"no fitted recording has an open-loop window of {WINDOW_S:g} s"
    free = problem.moved(problem.prior)
    params = sysid.ParameterDict()
    for i, (p, usual) in enumerate(free):
        params.add(_parameter(i, p, usual))
    spread = np.maximum(np.std(np.concatenate([s.q for s in fit]), axis=0), 1e-6)
    try:
        parts = [_residual(model, s, own, spread) for s, own in pieces if own]
    except ValueError as error:  # of MuJoCo's compiler
        return f"the model with one motor per joint does not compile: {error}"
    tried = _Tried(parts, time.process_time() + limit_s, params.as_vector())
    cut_off = False
    try:
        sysid.optimize(
            params, tried, optimizer="mujoco", verbose=False, max_iters=ITERATIONS, eps=DIFFERENCE,
            output=io.StringIO(),
        )  # fmt: skip
    except _OutOfTimeError:
        cut_off = True
    moved = [(p, float(x)) for (p, _), x in zip(free, tried.best, strict=True)]
    return Identified(moved, sum(len(own) for _, own in pieces), cut_off)


def _pieces(fit: list[Session], held_apart: bool) -> list[tuple[Session, list[tuple[int, int]]]]:
    """Windows of the fitted rows by recording, at most ``WINDOWS`` in all, evenly picked."""
    every = [
        (s, start, stop)
        for s in fit
        for start, stop in windows(s, WINDOW_S)
        if held_apart or stop <= first_held(s)
    ]
    picks = np.unique(np.linspace(0, len(every) - 1, min(WINDOWS, len(every))).round().astype(int))
    chosen = [every[i] for i in picks]
    return [(s, [(a, b) for other, a, b in chosen if other is s]) for s in fit]


def _parameter(number: int, p: BaseParameter, usual: float) -> sysid.Parameter:
    """A parameter in units of its size, zero being the model's value, ``usual`` what it usually errs by."""
    far = BOUND * usual
    least = -(1.0 - LEAST_LEFT) * p.nominal / p.size if p.name in NEVER_NEGATIVE else -far

    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        x = float(parameter.value[0])
        p.write(spec, x)
        if p.name == "effort_offset":
            spec.actuator(MOTOR + p.place).biasprm[0] = -x * p.size

    return sysid.Parameter(f"{number}", 0.0, max(least, -far), far, modifier=write)


class _Tried:
    """The sum over all recordings in the toolbox's form, which remembers the best it was asked about."""

    def __init__(self, parts: Sequence[Callable], deadline: float, start: np.ndarray) -> None:
        self.parts, self.deadline = parts, deadline
        self.best, self.least = start, np.inf

    def __call__(self, x: np.ndarray, params: sysid.ParameterDict) -> tuple[list[np.ndarray], list, list]:
        if time.process_time() > self.deadline:
            raise _OutOfTimeError
        found = [r for part in self.parts for r in part(x, params)[0]]
        if x.size == self.best.size:
            cost = float(sum(np.sum(r**2) for r in found))
            if cost < self.least:
                self.best, self.least = x.reshape(-1).copy(), cost
        return found, [], []


def _residual(model: RigidModel, s: Session, own: list[tuple[int, int]], spread: np.ndarray) -> Callable:
    """The toolbox's residual over the windows of one recording."""
    spec = _driven(model, s)
    compiled = spec.compile()
    every = max(1, int(np.ceil(s.dt / min(model.model.opt.timestep, STEP_S) - 1e-9)))
    spec.option.timestep = s.dt / every
    adr = np.array([int(compiled.joint(name).qposadr[0]) for name in model.joints])
    dof = np.array([int(compiled.joint(name).dofadr[0]) for name in model.joints])
    low, high = model.effort_limits()
    force = np.clip(np.nan_to_num(s.u - s.pushed), low, high) + s.pushed
    states, controls, measured = [], [], []
    rest = mujoco.MjData(compiled)
    for start, stop in own:
        q, v = rest.qpos.copy(), rest.qvel.copy()
        q[adr], v[dof] = s.q[start], s.v[start]
        states.append(sysid.create_initial_state(compiled, q, v))
        u = np.repeat(force[start:stop], every, axis=0)
        controls.append(sysid.TimeSeries(np.arange(len(u)) * s.dt / every, u))
        measured.append(sysid.TimeSeries(np.arange(stop - start) * s.dt, s.q[start:stop]))

    def missed(
        _params: sysid.ParameterDict, _predicted: sysid.TimeSeries, seen: sysid.TimeSeries, _model: mujoco.MjModel,
        _return_all: bool, *, state: np.ndarray,
    ) -> tuple[np.ndarray, sysid.TimeSeries, sysid.TimeSeries]:  # fmt: skip
        at = np.arange(1, len(seen.data)) * every - 1
        wrong = state[at][:, 1 + adr] - seen.data[1:]
        return np.where(np.isfinite(wrong), np.clip(wrong, -LOST, LOST), LOST) / spread, seen, seen

    return sysid.build_residual_fn(
        models_sequences=[
            sysid.ModelSequences(s.rec.name, spec, [str(k) for k in range(len(own))], states, controls, measured)
        ],
        build_model=partial(_built, {}), modify_residual=missed, resample_true=False, n_threads=1,
    )  # fmt: skip


def _built(
    kept: dict[bytes, mujoco.MjModel], params: sysid.ParameterDict, spec: mujoco.MjSpec
) -> mujoco.MjModel:
    """The model with these parameters; the toolbox asks for it once per window."""
    key = params.as_vector().tobytes()
    if key not in kept:
        if len(kept) > 2 * params.size + 2:
            kept.clear()
        fresh = spec.copy()
        for one in params.values():
            one.apply_modifier(fresh)
        kept[key] = fresh.compile()
    return kept[key]


def _driven(model: RigidModel, s: Session) -> mujoco.MjSpec:
    """The model with one motor and one position sensor per joint, its own drives taken out; dry friction is hard."""
    spec = model.spec.copy()
    for kind in (spec.keys, spec.sensors, spec.actuators):
        for one in list(kind):
            spec.delete(one)
    for j, name in enumerate(model.joints):
        motor = plain_motor(spec, MOTOR + name, name)
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        sensor = spec.add_sensor(name=MOTOR + name, type=mujoco.mjtSensor.mjSENS_JOINTPOS)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_JOINT, name
        if s.lead[j] == 0.0:
            joint = spec.joint(name)
            joint.solref_friction, joint.solimp_friction = HARD_SOLREF, HARD_SOLIMP
    return spec
