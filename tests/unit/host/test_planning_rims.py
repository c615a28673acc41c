"""Where a part may reach to without being counted on: the robot keeps clear of it, and nothing touches it."""

import numpy as np
import pytest

from s2r_host.motion.object_shapes import object_obstacles
from s2r_host.planning import PlanSettings
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.free_space import FINE_STEP_RAD, FreeSpace
from s2r_host.planning.hooking import find_hooks
from s2r_host.planning.scene import build_scene
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
SURE_M, BEYOND_M = 0.2, 0.1
PLATE = """<mujoco><compiler angle="radian"/><worldbody><body name="object_base"/>
<body name="object_part" pos="0.65 0 0.02"><joint name="object_joint" axis="0 1 0" range="-1.2 1.2" frictionloss="0.3"/>
<geom name="part_plate" type="box" pos="0 0 {middle}" size="0.004 0.15 {half}" density="500"/>{rim}</body>
</worldbody></mujoco>"""
RIM = """<geom name="rim_plate" type="box" pos="0 0 {middle}" size="0.004 0.15 {half}" density="0" contype="0"
 conaffinity="0"/>"""


@pytest.fixture
def world_of(tmp_path):
    """``world_of(beyond_m)``: an upright plate whose rim ends that far beyond it; none for 0."""

    def built(beyond_m: float) -> FineWorld:
        half = 0.5 * (SURE_M + beyond_m)
        rim = RIM.format(middle=half, half=half) if beyond_m else ""
        path = tmp_path / f"{beyond_m}.xml"
        path.write_text(PLATE.format(middle=0.5 * SURE_M, half=0.5 * SURE_M, rim=rim))
        return FineWorld(build_scene(ARM, path, "object_joint", PlanSettings()), ARM.q_home, 0.0)

    return built


def _clear(world: FineWorld, hooks: list) -> list[bool]:
    """Whether the arm's way to each place keeps clear of the rim."""
    space = FreeSpace(world.scene, 1, others=world.others, rims=True)
    ways = [np.concatenate([[ARM.q_home], hook.approach, hook.route[:2]]) for hook in hooks]
    return [space.path_is_free(way, 0.0, FINE_STEP_RAD) for way in ways]


def test_the_way_over_an_edge_keeps_clear_of_where_that_may_be(world_of):
    plain, rimmed = world_of(0.0), world_of(BEYOND_M)
    towards = -0.4  # the arm has to reach over the plate's edge
    usual = find_hooks(plain.scene, plain, "plate.xml", towards, PlanSettings())
    clear = find_hooks(rimmed.scene, rimmed, "plate.xml", towards, PlanSettings())
    assert not all(_clear(rimmed, usual))
    assert all(_clear(rimmed, clear))


def test_where_nothing_keeps_clear_the_sure_part_is_what_counts(world_of):
    plain, rimmed = world_of(0.0), world_of(0.5)
    usual, found = (find_hooks(one.scene, one, "plate.xml", 0.4, PlanSettings()) for one in (plain, rimmed))
    assert found
    assert [hook.q.tolist() for hook in found] == [hook.q.tolist() for hook in usual]


def test_a_rim_is_not_touched_and_weighs_nothing(world_of, tmp_path):
    plain, rimmed = world_of(0.0).scene, world_of(BEYOND_M).scene
    assert rimmed.rims.sum() == 1
    assert not (rimmed.rims & rimmed.solid).any()
    assert rimmed.fine.body_mass[rimmed.part_body] == pytest.approx(plain.fine.body_mass[plain.part_body])
    assert [one.name for one in object_obstacles(tmp_path / f"{BEYOND_M}.xml", 0.0)] == ["part_plate"]


def test_the_rims_of_a_scene_are_kept_clear_of_too(tmp_path):
    half = 0.5 * (SURE_M + BEYOND_M)
    rim = RIM.format(middle=half, half=half)
    text = PLATE.format(middle=0.5 * SURE_M, half=0.5 * SURE_M, rim=rim)
    (tmp_path / "object.xml").write_text(text)
    # A scene of somebody who lets everything meet everything.
    all_bits = text.replace('density="500"', 'density="500" contype="2147483647" conaffinity="2147483647"')
    base = '<worldbody><site name="arm_base"/><geom name="ground" type="plane" size="2 2 0.1"/>'
    (tmp_path / "scene.xml").write_text(all_bits.replace("<worldbody>", base))
    scenes = [
        build_scene(ARM, tmp_path / name, "object_joint", PlanSettings(), in_scene=name == "scene.xml")
        for name in ("object.xml", "scene.xml")
    ]
    postures = ARM.q_home + np.random.default_rng(0).normal(scale=0.35, size=(3000, ARM.dof))
    sure = FreeSpace(scenes[0], 1).touches(postures, 0.0)
    with_rim, in_scene = (FreeSpace(scene, 1, rims=True).touches(postures, 0.0) for scene in scenes)
    assert (with_rim & ~sure).any()
    assert (in_scene == with_rim).all()
    assert scenes[1].rims.sum() == 1
    assert not (scenes[1].rims & scenes[1].solid).any()
    assert FineWorld(scenes[1], ARM.q_home, 0.0).data.ncon == 0
