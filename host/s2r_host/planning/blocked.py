"""Parts that no push of the arm brings to the target: stuck in something, or too stiff.

A handle modelled into the table or a door that stands in the floor looks well in a viewer, and a search for a plan
would try every place before it gave up. So the part alone is pushed at its outermost point, harder than the arm will,
and it is watched where it gets to.
"""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.planning.part_alone import alone_at, alone_model, is_coupled, overlap
from s2r_host.planning.part_shape import outermost_lever, part_geoms
from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRefusedError, PlanRequest

_ARM_M = (
    0.3  # at which the arm's strongest joint would push with what contact may take of it; few reach as near
)
_WAY_S = 0.5  # in which the push makes the way of a part that resists with nothing
_WATCHED_S = 2.0
_LOOK_STEPS = 5
_LATE_S = 0.25  # at the end of that: who still moves gets there sooner or later
_MOST_S = 5.0  # for the whole way at the speed of the end
_WORTH_SAYING = 0.01  # N, N·m and, for damping, those times s/m or s/rad


def check_gets_there(request: PlanRequest, scene: Scene, tolerance: float) -> None:
    """Refuse a target that the part does not get to, however hard it is pushed.

    Args:
        request: The task.
        scene: Its scene.
        tolerance: Success band of the joint [m or rad].

    Raises:
        PlanRefusedError: It is blocked; the text says where and by what.
    """
    if is_coupled(scene) or not len(part_geoms(scene)):
        return  # a part that nothing can touch is refused where places are looked for
    model = alone_model(scene)
    data = alone_at(model, request, scene, request.s_initial)
    way = request.s_target - request.s_initial
    push_N = request.settings.contact_margin * float(scene.arm.limits.tau_max.max()) / _ARM_M
    push = push_N * outermost_lever(scene, data)
    # A push that gets weaker with speed, by damping, which the integrator takes well for the lightest of parts.
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_damping[scene.s_dof] += push / (abs(way) / _WAY_S)
    data.qfrc_applied[scene.s_dof] = np.sign(way) * push
    late: list[float] = []
    for _ in range(round(_WATCHED_S / (_LOOK_STEPS * model.opt.timestep))):
        mujoco.mj_step(model, data, _LOOK_STEPS)
        left = (request.s_target - data.qpos[scene.s_qpos]) * np.sign(way)
        if left < tolerance:
            return
        if data.time > _WATCHED_S - _LATE_S:
            late.append(left)
    if not np.isfinite(late).all() or (late[0] - late[-1]) / _LATE_S > abs(way) / _MOST_S:
        return
    raise PlanRefusedError(_why(model, data, request, scene, push_N))


def _why(
    model: mujoco.MjModel, data: mujoco.MjData, request: PlanRequest, scene: Scene, push_N: float
) -> str:
    s, dof = float(data.qpos[scene.s_qpos]), scene.s_dof
    unit, force = ("m", "N") if scene.prismatic else ("rad", "N·m")
    stops = (
        f"joint {request.joint!r} does not get to target = {request.s_target:.4f}: pushed with {push_N:.0f} N at "
        f"its outermost point, the part alone gets from {request.s_initial:.4f} to {s:.4f} {unit} in {_WATCHED_S:g} s"
    )
    overlapping = overlap(model, data, scene)
    if overlapping is not None:
        return f"{stops}; there it {overlapping}: make room for it, or exclude the pair"
    speed = "N·s/m" if scene.prismatic else "N·m·s/rad"
    takes = ", ".join(
        f"{what} {abs(float(value)):.3g} {of}"
        for what, value, of in (
            ("friction", model.dof_frictionloss[dof], force),
            ("gravity", data.qfrc_bias[dof], force),
            ("springs", data.qfrc_spring[dof], force),
            ("damping", scene.fine.dof_damping[dof], speed),
        )
        if abs(value) > _WORTH_SAYING
    )
    return f"{stops}; there it resists with {takes}: arm {scene.arm.name!r} does not move that"
