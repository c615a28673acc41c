"""Receding-horizon planning through contact: iCEM in the coarse model, every action executed in the fine one."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from s2r_host.planning.blocked import check_gets_there
from s2r_host.planning.cascade import Cascade
from s2r_host.planning.door import check_links, check_numbers, check_target
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hook import Hook
from s2r_host.planning.hooking import find_hooks
from s2r_host.planning.out_of_reach import OutOfReachError
from s2r_host.planning.part_shape import outermost_lever
from s2r_host.planning.patience import Patience
from s2r_host.planning.proposals import Route
from s2r_host.planning.rewards import Task
from s2r_host.planning.sampler import SamplerFactory, icem_sampler
from s2r_host.planning.scene import Scene, build_scene
from s2r_host.planning.staying import check_stays, s_after
from s2r_host.planning.task import PlanRefusedError, PlanRequest, PlanResult

_CREPT_M = 0.003  # way of a part's outermost point from which on it is somewhere else


def scene_of(request: PlanRequest) -> Scene:
    """The two models that a request is planned in.

    Raises:
        SceneFileError: The object file is unusable.
    """
    return build_scene(
        request.arm, request.object_mjcf, request.joint, request.settings, in_scene=request.in_scene
    )


def world_of(request: PlanRequest, scene: Scene) -> FineWorld:
    """The fine model where a request begins."""
    return FineWorld(scene, np.asarray(request.q_initial, dtype=float), request.s_initial, request.others)


def plan_manipulation(
    request: PlanRequest,
    scene: Scene | None = None,
    patience: Patience | None = None,
    sampler: SamplerFactory = icem_sampler,
) -> PlanResult:
    """Plan how the arm moves the object's joint from ``s_initial`` to ``s_target``.

    Every action is chosen by rollouts in the coarse model and executed in the fine model, whose state the next
    rollouts start from. The plan is delivered only after the fine model has held the target for ``hold_s`` and a
    replay has found no unexpected contact at any substep; else the next stage of the cascade tries, and after the last
    one the result says why there is no plan. Torques are judged once it is timed.

    Args:
        request: The task.
        scene: Its scene, if it has been built already.
        patience: A limit on the time, and who is told about progress.
        sampler: What draws the action sequences.

    Raises:
        PlanRefusedError: The request is impossible or absurd; the text says which.
        OutOfReachError: The arm cannot get its fingertip behind the part.
        SceneFileError: The object file is unusable.
        TimeIsUpError: The time limit has passed.
    """
    start_wall, start_cpu = time.perf_counter(), time.process_time()
    patience = patience or Patience()
    check_numbers(request)
    settings = request.settings
    scene = scene or scene_of(request)
    tolerance = settings.tolerance_m if scene.prismatic else settings.tolerance_rad
    world = world_of(request, scene)
    _check_possible(request, scene, world, tolerance)
    before_places = time.process_time()
    hooks = _hooks_on_arrival(request, scene, world, patience)
    places_cpu_s = time.process_time() - before_places
    task = Task(request.s_initial, request.s_target, tolerance, scene.prismatic)
    cascade = Cascade(request, scene, task, world, hooks, patience, sampler)
    cascade.run()
    result = cascade.attempts[-1].result(cascade.attempts)
    return replace(
        result,
        cpu_s=time.process_time() - start_cpu,
        wall_s=time.perf_counter() - start_wall,
        places_cpu_s=places_cpu_s,
    )


def _hooks_on_arrival(request: PlanRequest, scene: Scene, world: FineWorld, patience: Patience) -> list[Hook]:
    """Places for the fingertip where a part that creeps will be by the time the hand is there.

    Dry friction in MuJoCo is soft unless the file makes it firm: whatever gravity pulls at, sinks. A lid that is held
    up by its hinge would come down on a hand that is on its way to a place just below where the lid is now.
    """
    settings = request.settings

    def found(start: FineWorld) -> list[Hook]:
        return find_hooks(
            scene,
            start,
            request.object_mjcf,
            request.s_target,
            settings,
            leave=request.leave,
            patience=patience,
        )

    hooks = found(world)
    if not settings.lead_in:
        return hooks
    ways = [np.concatenate([world.q[None], hook.whole_route[: hook.touch_row]]) for hook in hooks]
    steps = np.median([len(Route(way, settings.action_max_rad).points) for way in ways])
    s_there = s_after(request, scene, float(steps) * settings.control_dt_s)
    crept_m = abs(s_there - request.s_initial) * outermost_lever(scene, world.data)
    nearer = (s_there - request.s_initial) * (request.s_target - request.s_initial) > 0.0
    if crept_m < _CREPT_M or nearer:
        return hooks
    try:
        return found(FineWorld(scene, np.asarray(request.q_initial, dtype=float), s_there, request.others))
    except OutOfReachError:
        return hooks


def is_possible(request: PlanRequest, scene: Scene) -> bool:
    """Whether a request passes the door: what then fails is the search for a plan."""
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    try:
        check_numbers(request)
        _check_possible(request, scene, world_of(request, scene), tolerance)
    except PlanRefusedError:
        return False
    return True


def _check_possible(request: PlanRequest, scene: Scene, world: FineWorld, tolerance: float) -> None:
    check_target(request, scene, tolerance)
    check_stays(request, scene, tolerance)
    check_gets_there(request, scene, tolerance)
    contact = world.check_now().contact
    if contact is not None:
        raise PlanRefusedError(
            f"the start pose is in contact: {contact}; move the arm away from the object first"
        )
    check_links(request, scene)
