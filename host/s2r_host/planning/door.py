"""Requests that are refused before anything is planned."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.planning.out_of_reach import arm_reach_m
from s2r_host.planning.scene import GeomKind, Scene
from s2r_host.planning.scene_spec import FIRM_SOLIMP, FIRM_SOLREF, OBJECT_PREFIX
from s2r_host.planning.task import PlanRefusedError, PlanRequest

_STAY_S = 0.6  # how long an untouched part is watched
# Success bands that a part may creep meanwhile below a friction that would hold it. More than the first is said, more
# than the second is refused: by the time the hand is there the part is elsewhere.
_CREEPS, _CREEPS_AWAY = 5.0, 10.0
_MOST_TURNS = 4.0  # of a hinge without limits; a plan of many legs makes about two
_FROZEN = 1e6  # armature and damping of what shall not move


def check_numbers(request: PlanRequest) -> None:
    """Refuse numbers that are not finite, wrong joint counts and moves of nothing."""
    arm = request.arm
    q = np.asarray(request.q_initial, dtype=float)
    if q.shape != (arm.dof,):
        raise PlanRefusedError(f"q_initial has shape {q.shape}; arm {arm.name!r} needs ({arm.dof},)")
    for name, value in (("s_initial", request.s_initial), ("s_target", request.s_target)):
        if not np.isfinite(value):
            raise PlanRefusedError(f"{name} = {value} is not a finite number")
    for name, value in zip(arm.joint_names, q, strict=True):
        if not np.isfinite(value):
            raise PlanRefusedError(f"joint {name!r}: q_initial = {value} is not a finite number")
    limits = arm.limits
    for i, name in enumerate(arm.joint_names):
        if not limits.q_min[i] <= q[i] <= limits.q_max[i]:
            raise PlanRefusedError(
                f"joint {name!r} (index {i}): q_initial = {q[i]:.3f} rad is outside "
                f"[{limits.q_min[i]:.3f}, {limits.q_max[i]:.3f}] rad"
            )


def check_target(request: PlanRequest, scene: Scene, tolerance: float) -> None:
    """Refuse targets that are where the joint already is, or where it cannot be."""
    unit = "m" if scene.prismatic else "rad"
    s_initial, s_target = request.s_initial, request.s_target
    if abs(s_target - s_initial) < tolerance:
        raise PlanRefusedError(
            f"joint {request.joint!r}: s_target = {s_target:.4f} {unit} equals s_initial = {s_initial:.4f} {unit} "
            f"within the success band of {tolerance:g} {unit}: there is nothing to move"
        )
    if scene.s_range is None:
        _refuse_absurd_way(request, scene)
        return
    low, high = scene.s_range
    for name, value, slack in (("s_initial", s_initial, tolerance), ("s_target", s_target, 0.0)):
        if not low - slack <= value <= high + slack:
            raise PlanRefusedError(
                f"joint {request.joint!r}: {name} = {value:.4f} {unit} is beyond its range "
                f"[{low:.4f}, {high:.4f}] {unit}{_in_degrees(scene, value)}"
            )


def _refuse_absurd_way(request: PlanRequest, scene: Scene) -> None:
    """Refuse ways of a joint without limits that no arm goes along with."""
    way = abs(request.s_target - request.s_initial)
    reach_m = arm_reach_m(scene)
    if scene.prismatic and way > 2.0 * reach_m:
        raise PlanRefusedError(
            f"joint {request.joint!r}: s_target = {request.s_target:g} m is {way:g} m away, farther than the arm "
            f"{scene.arm.name!r} gets from one side of its base to the other, {2.0 * reach_m:.2f} m"
        )
    turns = way / (2.0 * np.pi)
    if not scene.prismatic and turns > _MOST_TURNS:
        raise PlanRefusedError(
            f"joint {request.joint!r}: s_target = {request.s_target:g} rad is {turns:.1f} turns away, more than the "
            f"{_MOST_TURNS:g} that are planned; is it meant in degrees?"
        )


def _in_degrees(scene: Scene, value: float) -> str:
    """A hint where the range would hold the value if its numbers were radians, for the end of a sentence."""
    if scene.prismatic or scene.s_range is None:
        return ""
    low, high = np.rad2deg(scene.s_range)
    if high - low > 2.0 * np.pi or not low <= value <= high:
        return ""
    return (
        f"; the file's angles are degrees: were [{low:.4g}, {high:.4g}] meant as radians, it needs "
        '<compiler angle="radian"/>'
    )


def check_stays(request: PlanRequest, scene: Scene, tolerance: float) -> None:
    """Refuse objects that do not stay untouched, where they are now or at the target.

    A lid that is lighter in friction than gravity falls back as soon as the arm leaves it, so no target but a stop can
    be held. Watched in the fine model with an arm that touches nothing.
    """
    if is_coupled(scene):
        return
    for name, s in (("s_initial", request.s_initial), ("s_target", request.s_target)):
        problem = drift(request, scene, tolerance, s, creep_bands=_CREEPS_AWAY)
        if problem is not None:
            raise PlanRefusedError(f"joint {request.joint!r} does not stay at {name} = {s:.4f}: {problem}")


def creeping(request: PlanRequest, scene: Scene) -> str | None:
    """That an untouched part creeps, though slowly enough to be planned for, and what ends that; or None."""
    if is_coupled(scene):
        return None
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    for name, s in (("s_initial", request.s_initial), ("s_target", request.s_target)):
        problem = drift(request, scene, tolerance, s)
        if problem is not None:
            return f"joint {request.joint!r} creeps at {name} = {s:.4f}: {problem}"
    return None


def is_coupled(scene: Scene) -> bool:
    """Whether other things may move along with the joint: they would be in other places than one can tell."""
    return bool(scene.fine.eq_active0.any() or scene.fine.tendon_limited.any())


def drift(
    request: PlanRequest, scene: Scene, tolerance: float, s: float, *, creep_bands: float = _CREEPS
) -> str | None:
    """Why an untouched part leaves joint value s, or None; by ``creep_bands`` it may where its friction should hold."""
    model = _alone(scene)
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
    overlap = _touches_its_surroundings(model, mujoco.MjData(model), scene, s)
    if overlap is not None:
        return f"{moves}; there it {overlap}: leave room between them, or exclude the pair"
    return f"{moves}: {pushed}; {_remedy(model, request, scene, s, friction, force)}"


def _moved(model: mujoco.MjModel, request: PlanRequest, scene: Scene, s: float) -> tuple[float, float, float]:
    """How far an untouched part goes from s while it is watched, what pushes it at first, and the motor's share."""
    data = mujoco.MjData(model)
    if request.others is not None:
        data.qpos[scene.dof :] = request.others
    data.qpos[: scene.dof] = data.ctrl[: scene.dof] = np.asarray(request.q_initial, dtype=float)
    data.qpos[scene.s_qpos] = s
    mujoco.mj_forward(model, data)
    motor = float(data.qfrc_actuator[scene.s_dof])
    load = motor + float(data.qfrc_passive[scene.s_dof] - data.qfrc_bias[scene.s_dof])
    for _ in range(round(_STAY_S / model.opt.timestep)):
        mujoco.mj_step(model, data)
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


def _alone(scene: Scene) -> mujoco.MjModel:
    """The fine model in which nothing but the task's joint moves, and nothing that could is in its way."""
    model = scene.without_robot()
    others = np.arange(model.nv) != scene.s_dof
    others[: scene.dof] = False
    model.dof_armature[others] = model.dof_damping[others] = _FROZEN
    for geom in range(model.ngeom):
        body = model.geom_bodyid[geom]
        if scene.geom_kind[geom] == GeomKind.WORLD and model.body_weldid[body] != 0:
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
    return model


def _touches_its_surroundings(
    model: mujoco.MjModel, data: mujoco.MjData, scene: Scene, s: float
) -> str | None:
    """What of the scene the untouched part overlaps with at joint value s, or None."""
    mujoco.mj_resetData(model, data)
    data.qpos[scene.s_qpos] = s
    mujoco.mj_forward(model, data)
    for contact in data.contact:
        kinds = scene.geom_kind[contact.geom]
        if (kinds == GeomKind.PART).sum() == 1 and contact.dist < 0.0:
            one, other = (_name(model, int(geom)) for geom in contact.geom)
            return f"overlaps by {-1e3 * contact.dist:.1f} mm ({one} with {other})"
    return None


def _name(model: mujoco.MjModel, geom: int) -> str:
    """A geom as its file calls it, or its kind and body."""
    body = int(model.geom_bodyid[geom])
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    own, of = (thing.name.removeprefix(OBJECT_PREFIX) for thing in (model.geom(geom), model.body(body)))
    return own or f"a {kind} of body {of or body!r}"
