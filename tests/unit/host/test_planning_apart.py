"""Room around the robot: asked for after a motion that hit a slightly different object, given where there is any."""

import importlib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from s2r_host.planning import PlanRequest, PlanSettings
from s2r_host.planning.free_space import FINE_STEP_RAD, FreeSpace
from s2r_host.planning.hooking import find_hooks
from s2r_host.planning.planner import scene_of, world_of
from s2r_host.planning.scene import GeomKind
from s2r_host.planning.settings import PlanSettingsError
from s2r_host.planning.task import PlanRefusedError
from s2r_host.trajectory import plan_trajectory
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
DOORS = Path(__file__).parents[2] / "bench/scenes/double_doors.xml"  # two handles with 10 cm between them
APART_M = 0.004
DELIVER = importlib.import_module(plan_trajectory.__module__)  # its name in the package is a function's


@pytest.fixture(scope="module")
def task():
    settings = PlanSettings(threads=1)
    request = PlanRequest(ARM, DOORS, 0.0, 0.535, ARM.q_home, "rdoor", in_scene=True, settings=settings)
    scene = scene_of(request)
    return request, scene, world_of(request, scene)


def hooks_with(task, apart_m):
    request, scene, world = task
    settings = replace(request.settings, apart_m=apart_m)
    return find_hooks(scene, world, DOORS, request.s_target, settings, leave=True)


def free(task, hooks, margin_m):
    """Whether the arm's way to each place is free, with so much room."""
    request, scene, world = task
    space = FreeSpace(scene, 1, margin_m, world.others)
    ways = [np.concatenate([[request.q_initial], hook.approach, hook.route[:2]]) for hook in hooks]
    return [space.path_is_free(way, 0.0, FINE_STEP_RAD) for way in ways]


def test_the_robot_keeps_the_room_it_is_asked_for_on_its_way_to_a_place(task):
    usual, apart = hooks_with(task, 0.0), hooks_with(task, APART_M)
    assert all(free(task, usual, 0.0))
    assert not any(
        free(task, usual, APART_M)
    )  # the places that are found first lie close to the other handle
    assert all(free(task, apart, APART_M))


def test_where_no_place_leaves_so_much_room_the_usual_ones_are_taken(task):
    usual, apart = hooks_with(task, 0.0), hooks_with(task, 0.2)
    assert [hook.q.tolist() for hook in apart] == [hook.q.tolist() for hook in usual]


def test_room_is_what_lies_between_the_shapes(task):
    request, scene, world = task
    hook = hooks_with(task, 0.0)[0]
    way = np.concatenate([[request.q_initial], hook.approach, hook.route[:2]])
    points = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(way)])
    room_m = np.array([least_room_m(scene, world, q) for q in points])
    counted = FreeSpace(scene, 1, APART_M, world.others).touches(points, 0.0)
    near, far = room_m < 0.95 * APART_M, room_m > 1.05 * APART_M
    assert near.sum() >= 5
    assert far.sum() >= 50
    assert counted[near].all()
    assert not counted[far].any()


def least_room_m(scene, world, q):
    """Distance between robot and everything else, but of fingertip and part, shape by shape."""
    model, data = scene.fine, mujoco.MjData(scene.fine)
    data.qpos[:] = world.data.qpos
    data.qpos[: scene.dof] = q
    mujoco.mj_kinematics(model, data)
    kind, moves = scene.geom_kind, model.body_weldid[model.geom_bodyid] > 0
    return min(
        mujoco.mj_geomDistance(model, data, int(robot), int(other), 0.05, None)
        for robot in np.flatnonzero(scene.solid & (kind >= GeomKind.ROBOT) & moves)
        for other in np.flatnonzero(scene.solid & (kind < GeomKind.ROBOT))
        if not (kind[robot] == GeomKind.FINGER and kind[other] == GeomKind.PART)
    )


def test_room_is_a_distance():
    with pytest.raises(PlanSettingsError, match="apart_m"):
        PlanSettings(apart_m=-0.001)


def test_after_a_timed_motion_that_hits_something_the_next_one_keeps_room(task, monkeypatch):
    request, scene, _ = task
    wanted = []

    def plan(planned, *_):
        wanted.append(planned.settings.apart_m)
        return SimpleNamespace(success=True)

    def delivered(*_, **__):
        if len(wanted) == 1:
            raise DELIVER.MotionHitsError("finger against case")
        raise PlanRefusedError("too slow")

    monkeypatch.setattr(DELIVER, "plan_manipulation", plan)
    monkeypatch.setattr(DELIVER, "deliver", delivered)
    with pytest.raises(PlanRefusedError, match="too slow"):
        plan_trajectory(request, scene=scene, only_fragile=True)
    assert wanted == [0.0, APART_M]


@pytest.mark.parametrize(("hits", "asked"), [(True, [0.0, APART_M, APART_M]), (False, [0.0, 0.0, 0.0])])
def test_only_after_a_hit_is_room_asked_for(task, monkeypatch, hits, asked):
    request, scene, _ = task
    wanted, calm = [], SimpleNamespace(contact_share=0.1)

    def plan(planned, *_):
        wanted.append(planned.settings.apart_m)
        return SimpleNamespace(success=True)

    def delivered(*_, **__):
        if len(wanted) == 2:
            raise PlanRefusedError("no")
        return SimpleNamespace(fragile="fragile", hits=hits, replay=calm, strays=0.1)

    monkeypatch.setattr(DELIVER, "plan_manipulation", plan)
    monkeypatch.setattr(DELIVER, "deliver", delivered)
    _, delivery = plan_trajectory(request, scene=scene, accept_fragile=True)
    assert wanted == asked
    assert delivery.fragile == "fragile"
