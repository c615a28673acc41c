"""Parts that do not stay where they are left: they fall, or creep below a dry friction that should hold them."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.planning.part_alone import alone_at, alone_model, is_coupled, overlap
from s2r_host.planning.scene import Scene
from s2r_host.planning.scene_spec import FIRM_SOLIMP, FIRM_SOLREF
from s2r_host.planning.task import PlanRefusedError, PlanRequest

_STAY_S = 0.6  # how long an untouched part is watched
# Success bands that a part may creep meanwhile below a friction that would hold it. More than the first is said, more
# than the second is refused: it cannot be left anywhere.
_CREEPS, _CREEPS_AWAY = 5.0, 10.0
# Looked at every so many steps, and no longer once it gets no faster and would go on by no more than this [m or rad].
_LOOK_STEPS, _AT_REST = 25, 1e-5


def check_stays(request: PlanRequest, scene: Scene, tolerance: float) -> None:
    """Refuse objects that do not stay untouched, where they are now or at the target.

    A lid that is lighter in friction than gravity falls back as soon as the arm leaves it, so no target but a stop can
    be held. Watched in the fine model with an arm that touches nothing.
    """
    if is_coupled(scene):
        return
    for name, s in (("start", request.s_initial), ("target", request.s_target)):
        problem = drift(request, scene, tolerance, s, creep_bands=_CREEPS_AWAY)
        if problem is not None:
            raise PlanRefusedError(f"joint {request.joint!r} does not stay at {name} = {s:.4f}: {problem}")


def creeping(request: PlanRequest, scene: Scene) -> str | None:
    """That an untouched part creeps, though slowly enough to be planned for, and what ends that; or None."""
    if is_coupled(scene):
        return None
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    for name, s in (("start", request.s_initial), ("target", request.s_target)):
        problem = drift(request, scene, tolerance, s)
        if problem is not None:
            return f"joint {request.joint!r} creeps at {name} = {s:.4f}: {problem}"
    return None


def drift(
    request: PlanRequest, scene: Scene, tolerance: float, s: float, *, creep_bands: float = _CREEPS
) -> str | None:
    """Why an untouched part leaves joint value s, or None; by ``creep_bands`` it may where its friction should hold."""
    model = alone_model(scene)
    moved, load, motor = _moved(model, request, scene, s)
    friction = float(model.dof_frictionloss[scene.s_dof])
    unit, force = ("m", "N") if scene.prismatic else ("rad", "N·m")
    falls = abs(load) > friction and abs(moved) > tolerance
    if not falls and abs(moved) < creep_bands * tolerance:
        return None
    moves = f"untouched it moves by {moved:+.4f} {unit} in {_STAY_S:g} s"
    pushed = f"gravity and springs turn or push it with {abs(load):.2f} {force}"
    if abs(motor) > 0.5 * abs(load):
        pushed = f"the scene's own actuator, told 0, pushes it with {abs(motor):.2f} {force}"
    if abs(load) > friction:
        return f"{moves}, because {pushed} and its friction holds only {friction:.2f} {force}"
    overlapping = overlap(model, alone_at(model, request, scene, s), scene)
    if overlapping is not None:
        return f"{moves}; there it {overlapping}: leave room between them, or exclude the pair"
    return f"{moves}: {pushed}; {_remedy(model, request, scene, s, friction, force)}"


def s_after(request: PlanRequest, scene: Scene, seconds: float) -> float:
    """Where the untouched part is so long after the start [m or rad]: elsewhere if it creeps."""
    if is_coupled(scene):
        return request.s_initial
    moved, _, _ = _moved(alone_model(scene), request, scene, request.s_initial, seconds)
    return request.s_initial + moved


def _moved(
    model: mujoco.MjModel, request: PlanRequest, scene: Scene, s: float, watched_s: float = _STAY_S
) -> tuple[float, float, float]:
    """How far an untouched part goes from s while it is watched, what pushes it at first, and the motor's share."""
    data = alone_at(model, request, scene, s)
    motor = float(data.qfrc_actuator[scene.s_dof])
    load = motor + float(data.qfrc_passive[scene.s_dof] - data.qfrc_bias[scene.s_dof])
    left, speed = round(watched_s / model.opt.timestep), np.inf
    while left > 0:
        mujoco.mj_step(model, data, min(_LOOK_STEPS, left))
        left -= min(_LOOK_STEPS, left)
        before, speed = abs(speed), float(data.qvel[scene.s_dof])
        on = speed * left * model.opt.timestep
        if abs(speed) <= before and abs(on) < _AT_REST:
            return float(data.qpos[scene.s_qpos]) + on - s, load, motor
    return float(data.qpos[scene.s_qpos]) - s, load, motor


def _remedy(
    model: mujoco.MjModel, request: PlanRequest, scene: Scene, s: float, friction: float, force: str
) -> str:
    """What to set for a part that creeps below its friction, tried out, for the end of a sentence."""
    before = abs(_moved(model, request, scene, s)[0])
    model.dof_solref[scene.s_dof], model.dof_solimp[scene.s_dof] = FIRM_SOLREF, FIRM_SOLIMP
    after = abs(_moved(model, request, scene, s)[0])
    soft = f"dry friction as soft as the file has it creeps below its {friction:.2f} {force}"
    if after > 0.5 * before:
        return f"{soft}; give the joint more frictionloss"
    unit = "m" if scene.prismatic else "rad"
    attributes = 'solreffriction="{:g} {:g}" solimpfriction="{:g} {:g} {:g}"'.format(
        *FIRM_SOLREF, *FIRM_SOLIMP[:3]
    )
    return (
        f'{soft}; give <joint name="{request.joint}"> {attributes}, with which it moves by {after:.4f} {unit}'
    )
