"""Base parameters of the nominal model as regressors: what may be slightly wrong without being news."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_host.gap.motion.flat_bodies import EXACT, thickened
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.rows import effort_slope

WEAK = 0.03
TIMING = 0.5
STEP = 1e-2
COMPARISON = ("timing", "edge", "gain")  # of how efforts are compared, not of the machine


@dataclass(frozen=True)
class BaseParameter:
    """One parameter of the nominal model, varied in units of its own size.

    Attributes:
        name: As reported (``mass``, ``com_x``, ``damping``, ...).
        place: Body or joint it belongs to; ``on_joint`` tells which.
        nominal: Value in the model; ``size`` what one unit of the coefficient means; ``unit`` of both.
        prior: Standard deviation of the coefficient when it counts as a small error.
        column: Required effort per unit coefficient along a session, shape (time, joint).
    """

    name: str
    place: str
    on_joint: bool
    nominal: float
    size: float
    unit: str
    prior: float
    column: Callable[[Session], np.ndarray]
    write: Callable[[mujoco.MjSpec, float], None]


def base_parameters(model: RigidModel) -> list[BaseParameter]:
    """All base parameters with a noticeable influence, bodies first, then joints."""
    found: list[BaseParameter] = []
    for body in model.jointed_bodies():
        found += body_parameters(model, body)
    m = model.model
    for j, joint in enumerate(model.joints):
        if m.dof_damping[j] > 0:
            found.append(_damping(model, j, joint))
        if m.dof_frictionloss[j] > 0:
            found.append(_friction(model, j, joint))
        if m.dof_armature[j] > 0:
            found.append(_armature(model, j, joint))
        if m.jnt_stiffness[j] > 0:
            found.append(_stiffness(model, j, joint))
        found.append(_offset(model, j, joint))
        found.append(_hold(j, joint))
        found.append(_edge(model, j, joint))
    return found


def _varied(
    model: RigidModel, change: Callable[[mujoco.MjModel, float], None], key: str
) -> Callable[[Session], np.ndarray]:
    def column(s: Session) -> np.ndarray:
        stored = s.cache.get(("base", key))
        if stored is None:
            up = model.inverse(s.q, s.v, s.a, model.variant(lambda m: change(m, STEP)))
            stored = s.cache[("base", key)] = (up - s.load) / STEP
        return stored

    return column


def body_parameters(model: RigidModel, body: int) -> list[BaseParameter]:
    """Mass, inertia and centre of mass of one body."""
    m, name = model.model, model.body_name(body)
    size = max(float(np.linalg.norm(m.body_ipos[body])), _extent(m, body), 1e-3)

    def scale_mass(v: mujoco.MjModel, x: float) -> None:
        v.body_mass[body] *= 1.0 + x
        v.body_inertia[body] *= 1.0 + x

    def scale_inertia(v: mujoco.MjModel, x: float) -> None:
        v.body_inertia[body] *= 1.0 + x

    def write_mass(spec: mujoco.MjSpec, x: float) -> None:
        make_explicit(spec, model, body)
        b = spec.body(name)
        b.mass *= max(0.05, 1.0 + x)
        b.inertia = _scaled(np.asarray(b.inertia), max(0.05, 1.0 + x))

    def write_inertia(spec: mujoco.MjSpec, x: float) -> None:
        make_explicit(spec, model, body)
        b = spec.body(name)
        b.inertia = _scaled(np.asarray(b.inertia), 1.0 + x)

    found = [
        BaseParameter("mass", name, False, float(m.body_mass[body]), float(m.body_mass[body]), "kg", WEAK,
                      _varied(model, scale_mass, f"mass{body}"), write_mass),
        BaseParameter("inertia", name, False, float(np.max(m.body_inertia[body])),
                      float(np.max(m.body_inertia[body])), "kg·m²", 2 * WEAK,
                      _varied(model, scale_inertia, f"inertia{body}"), write_inertia),
    ]  # fmt: skip
    for axis, letter in enumerate("xyz"):

        def shift(v: mujoco.MjModel, x: float, axis: int = axis) -> None:
            v.body_ipos[body, axis] += x * size

        def write_shift(spec: mujoco.MjSpec, x: float, axis: int = axis) -> None:
            make_explicit(spec, model, body)
            b = spec.body(name)
            p = np.array(b.ipos)
            p[axis] += x * size
            b.ipos = p

        found.append(
            BaseParameter(f"com_{letter}", name, False, float(m.body_ipos[body, axis]), size, "m",
                          WEAK * abs(float(m.body_ipos[body, axis])) / size + 0.003,
                          _varied(model, shift, f"com{body}{axis}"), write_shift)
        )  # fmt: skip
    return found


def _scaled(moments: np.ndarray, factor: float) -> np.ndarray:
    """Moments of inertia times a factor, shape (3,), that MuJoCo takes."""
    return thickened(np.maximum(moments * factor, 1e-9), EXACT)


def make_explicit(spec: mujoco.MjSpec, model: RigidModel, body: int) -> None:
    """Give a body the inertia its geoms implied, as numbers that can be changed; keeps earlier changes."""
    m = model.model
    b = spec.body(model.body_name(body))
    if (
        b.explicitinertial
        and np.all(np.isfinite(b.ipos))
        and b.mass > 0
        and not np.isfinite(b.fullinertia[0])
    ):
        return
    b.explicitinertial = 1
    b.mass, b.ipos, b.iquat = float(m.body_mass[body]), m.body_ipos[body], m.body_iquat[body]
    b.inertia, b.fullinertia = m.body_inertia[body], np.full(6, np.nan)


def _extent(m: mujoco.MjModel, body: int) -> float:
    first, count = int(m.body_geomadr[body]), int(m.body_geomnum[body])
    return max((0.5 * float(m.geom_rbound[g]) for g in range(first, first + count)), default=0.0)


def _on_joint(s: Session, j: int, x: np.ndarray) -> np.ndarray:
    out = np.zeros_like(s.q)
    out[:, j] = x
    return out


def _damping(model: RigidModel, j: int, joint: str) -> BaseParameter:
    b = float(model.model.dof_damping[j])

    def write(spec: mujoco.MjSpec, x: float) -> None:
        d = np.array(spec.joint(joint).damping, dtype=float, ndmin=1)
        d[0] = max(0.0, d[0] + x * b)
        spec.joint(joint).damping = d if d.size > 1 else float(d[0])

    return BaseParameter(
        "damping",
        joint,
        True,
        b,
        b,
        model.damping_unit(joint),
        0.1,
        lambda s: _on_joint(s, j, b * s.v[:, j]),
        write,
    )


def _friction(model: RigidModel, j: int, joint: str) -> BaseParameter:
    f = float(model.model.dof_frictionloss[j])

    def write(spec: mujoco.MjSpec, x: float) -> None:
        spec.joint(joint).frictionloss = max(0.0, spec.joint(joint).frictionloss + x * f)

    return BaseParameter("frictionloss", joint, True, f, f, model.effort_unit(joint), 0.1,
                         lambda s: _on_joint(s, j, f * s.sign(j)), write)  # fmt: skip


def _armature(model: RigidModel, j: int, joint: str) -> BaseParameter:
    a = float(model.model.dof_armature[j])

    def write(spec: mujoco.MjSpec, x: float) -> None:
        spec.joint(joint).armature = max(0.0, spec.joint(joint).armature + x * a)

    return BaseParameter("armature", joint, True, a, a, model.inertia_unit(joint), 0.05,
                         lambda s: _on_joint(s, j, a * s.a[:, j]), write)  # fmt: skip


def _stiffness(model: RigidModel, j: int, joint: str) -> BaseParameter:
    k = float(model.model.jnt_stiffness[j])
    q0 = float(model.model.qpos_spring[model.model.jnt_qposadr[j]])

    def write(spec: mujoco.MjSpec, x: float) -> None:
        value = np.array(spec.joint(joint).stiffness, dtype=float, ndmin=1)
        value[0] = max(0.0, value[0] + x * k)
        spec.joint(joint).stiffness = value if value.size > 1 else float(value[0])

    unit = f"{model.effort_unit(joint)}/{model.unit(joint)}"
    return BaseParameter("stiffness", joint, True, k, k, unit, 0.05,
                         lambda s: _on_joint(s, j, k * (s.q[:, j] - q0)), write)  # fmt: skip


def _offset(model: RigidModel, j: int, joint: str) -> BaseParameter:
    """A constant in the effort channel: sensor zero or drive offset, one unit is one newton (metre)."""

    def write(spec: mujoco.MjSpec, x: float) -> None:
        del spec, x  # no stock attribute: the runtime adds it

    return BaseParameter("effort_offset", joint, True, 0.0, 1.0, model.effort_unit(joint), 0.0,
                         lambda s: _on_joint(s, j, np.ones(len(s.t))), write)  # fmt: skip


def recording_gains(model: RigidModel, sessions: Sequence[Session]) -> list[BaseParameter]:
    """The scale of each recording's effort, where its side file says how far that may be off (``effort_gain_sigma``).

    A force times a lever is such an effort: the lever is another one wherever the part is taken hold of.
    """
    found = []
    for own in sessions:
        for j, joint in enumerate(model.joints):
            sigma = own.rec.effort_gain_sigma.get(joint)
            if sigma is None:
                continue

            def column(s: Session, own: Session = own, j: int = j) -> np.ndarray:
                return _on_joint(s, j, s.u[:, j] if s is own and s.has_u[j] else np.zeros(len(s.t)))

            found.append(BaseParameter("gain", joint, True, 0.0, 1.0, "1", sigma, column, lambda *_: None))
    return found


def _hold(j: int, joint: str) -> BaseParameter:
    """Timing inside one sample, or one period of a controller of known rate: who logs when is rarely said."""

    def column(s: Session) -> np.ndarray:
        if not s.has_u[j]:
            return np.zeros_like(s.q)
        rate = s.rec.controller.rate_hz
        held = min(s.rec.as_read.dt, 1.0 / rate) if rate else s.rec.as_read.dt
        return _on_joint(s, j, held * effort_slope(s, j))

    return BaseParameter("timing", joint, True, 0.0, 1.0, "samples", TIMING, column, lambda *_: None)


def _edge(model: RigidModel, j: int, joint: str) -> BaseParameter:
    """Sharpness of the step dry friction makes at a reversal: the sign of a filtered speed is not the true one.

    One unit is one newton (metre) of friction whose edge is three times as wide as assumed; the prior is set from
    the friction found.
    """

    def column(s: Session) -> np.ndarray:
        sharp, wide = s.sign(j), np.tanh(s.slip(j) / (3.0 * s.v_eps[j]))
        return _on_joint(s, j, sharp - wide)

    return BaseParameter(
        "edge", joint, True, 0.0, 1.0, model.effort_unit(joint), 0.0, column, lambda *_: None
    )
