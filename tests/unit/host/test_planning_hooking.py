"""Places for the fingertip, the funnel around them, and routes through them."""

import numpy as np
import pytest

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hand_probe import HandProbe, quat_of
from s2r_host.planning.hook import TOUCH_WAYPOINT, Hook
from s2r_host.planning.hooking import find_hooks
from s2r_host.planning.kinematics import ToolKinematics, rotation_errors
from s2r_host.planning.places import Places, PlaceSearch, least_costs, tightness
from s2r_host.planning.proposals import Route
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf
from s2r_host.planning.scene import build_scene
from s2r_host.planning.settings import PlanSettings
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
SHAPE = DrawerShape()


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> FineWorld:
    path = tmp_path_factory.mktemp("drawer") / "object.xml"
    path.write_text(drawer_mjcf(SHAPE))
    return FineWorld(build_scene(ARM, path, "object_joint", PlanSettings()), ARM.q_home, 0.0)


@pytest.fixture(scope="module")
def hooks(world) -> list[Hook]:
    return find_hooks(world.scene, world, "object.xml", 0.15, PlanSettings())


def places_of(world: FineWorld, sign: float, points: int = 90, **how) -> Places:
    probe = HandProbe(world.scene, world.data, 1)
    return PlaceSearch(world.scene, world.data, probe, sign, points, **how).take(5000)


def test_places_for_pulling_are_free_and_behind_something_of_the_part(world):
    probe = HandProbe(world.scene, world.data, 1)
    places = places_of(world, 1.0)
    assert len(places) > 10
    quat = np.array([quat_of(R) for R in places.R])
    assert not probe.contacts(places.p, quat).any()
    pushed = places.p + places.push_m[:, None] * places.way
    assert probe.finger_contacts(pushed, quat).all()


def test_places_for_closing_are_in_front_of_the_front(world):
    places = places_of(world, -1.0)
    assert len(places) > 10
    assert places.way[:, 0] == pytest.approx(1.0)
    assert places.p[:, 0].min() < SHAPE.x - SHAPE.opening


def test_places_come_in_the_order_of_their_cost_however_they_are_asked_for(world):
    probe = HandProbe(world.scene, world.data, 1)
    search = PlaceSearch(world.scene, world.data, probe, 1.0, 30)
    one_by_one = Places.all_of([search.take(count) for count in (1, 3, 1, 40)])
    at_once = PlaceSearch(world.scene, world.data, probe, 1.0, 30).take(45)
    assert one_by_one.p.tolist() == at_once.p.tolist()
    assert one_by_one.blocked.tolist() == at_once.blocked.tolist()
    costs = least_costs(world.scene, world.data, at_once.p, at_once.R) + tightness(
        at_once, 0.012, np.zeros((0, 3))
    )
    assert (np.diff(costs) >= 0.0).all()
    for k, (p, R) in enumerate(zip(at_once.p, at_once.R, strict=True)):
        near = np.linalg.norm(at_once.p[:k] - p, axis=1) < 0.02
        assert (np.einsum("nij,ij->n", at_once.R[:k], R)[near] <= 2.9).all()  # none like one before


def test_the_first_places_take_a_look_at_some_candidates_only(world, monkeypatch):
    looked = []
    contacts = HandProbe.contacts

    def counted(probe, p, quat):
        looked.append(len(p))
        return contacts(probe, p, quat)

    monkeypatch.setattr(HandProbe, "contacts", counted)
    probe = HandProbe(world.scene, world.data, 1)
    PlaceSearch(world.scene, world.data, probe, 1.0, 30).take(24)
    some = sum(looked)
    looked.clear()
    PlaceSearch(world.scene, world.data, probe, 1.0, 30).take(10_000)
    assert some < 0.6 * sum(looked)


CROSS = """<mujoco><compiler angle="radian"/><worldbody><body name="part" pos=".55 -.15 .35">
<joint name="valve" axis="0 0 1" damping=".3"/>
<geom type="capsule" size=".01" fromto="-.12 0 0 .12 0 0" mass=".2"/>
<geom type="capsule" size=".01" fromto="0 -.12 0 0 .12 0" mass=".2"/></body></worldbody></mujoco>"""
UPRIGHT_BAR = """<mujoco><compiler angle="radian"/><worldbody>
<body name="part" pos=".6 .2 .3"><joint name="door" axis="0 0 1" range="-1.6 0" frictionloss=".3"/>
<geom type="box" size=".01 .175 .2" pos="0 -.175 0" mass="2"/>
<geom type="capsule" size=".008" fromto="-.05 -.3 -.06 -.05 -.3 .06" mass=".1"/>
<geom type="capsule" size=".006" fromto="0 -.3 .06 -.05 -.3 .06" mass=".1"/>
<geom type="capsule" size=".006" fromto="0 -.3 -.06 -.05 -.3 -.06" mass=".1"/></body></worldbody></mujoco>"""


@pytest.fixture
def world_of(tmp_path):
    def build(text: str, joint: str) -> FineWorld:
        path = tmp_path / "object.xml"
        path.write_text(text)
        return FineWorld(build_scene(ARM, path, joint, PlanSettings()), ARM.q_home, 0.0)

    return build


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_arm_of_a_cross_that_turns_about_its_middle_can_be_pushed(world_of, sign):
    world = world_of(CROSS, "valve")
    places = places_of(world, sign)
    middle = world.data.xpos[world.scene.part_body]
    outwards = (places.p - middle)[:, :2]
    # Each place goes round its own way, and none is so near the axis that it would take many times the force.
    assert (np.cross(np.c_[outwards, np.zeros(len(outwards))], places.way)[:, 2] * sign > 0.0).all()
    assert (np.linalg.norm(outwards, axis=1) > 0.03).all()
    quarters = {(bool(x > 0), bool(y > 0)) for x, y in places.way[:, :2]}
    assert len(quarters) == 4


def test_behind_an_upright_bar_close_to_its_door_the_hand_comes_obliquely(world_of):
    world = world_of(UPRIGHT_BAR, "door")

    def in_the_gap(oblique):
        points, ways = (500, "oblique") if oblique else (90, "usual")
        places = places_of(world, -1.0, points, ways=ways)
        x = (places.p - world.data.xpos[world.scene.part_body])[:, 0]
        return int(((x > -0.05) & (x < -0.01)).sum())

    assert in_the_gap(oblique=True) > 2 * in_the_gap(oblique=False)
    hooks = find_hooks(world.scene, world, "object.xml", -0.6, PlanSettings())
    for hook in hooks:
        assert -0.05 < hook.p_part[0] < 0.0


def test_hooks_have_joint_solutions_without_contact_from_the_touch_to_the_target(world, hooks):
    kinematics = ToolKinematics(world.scene, 0.0)
    for hook in hooks:
        p_start, p_end = (kinematics.pose(hook.route[row])[0] for row in (TOUCH_WAYPOINT, -1))
        assert p_end - p_start == pytest.approx([-0.15, 0.0, 0.0], abs=3e-3)
        assert (hook.route > ARM.limits.q_min).all()
        assert (hook.route < ARM.limits.q_max).all()


def test_places_from_which_nothing_was_moved_come_last(world, hooks):
    def found(missed):
        settings = PlanSettings(missed=tuple(map(tuple, missed.tolist())))
        return find_hooks(world.scene, world, "object.xml", 0.15, settings)

    first = hooks[0].p_part
    assert np.linalg.norm(found(first[None])[0].p_part - first) > 0.025
    x, y = np.meshgrid(np.arange(-0.3, 0.31, 0.02), np.arange(-0.3, 0.31, 0.02))
    everywhere = np.stack([x.ravel(), y.ravel(), np.full(x.size, first[2])], axis=1)
    everywhere = np.concatenate([everywhere + np.array([0.0, 0.0, dz]) for dz in np.arange(-0.1, 0.11, 0.02)])
    assert found(everywhere)  # rather than none


def test_the_place_from_which_the_part_was_moved_comes_first_again(world, hooks):
    for other in hooks[1:]:
        settings = PlanSettings(proven=(tuple(other.p_part.tolist()),))
        again = find_hooks(world.scene, world, "object.xml", 0.15, settings)[0].p_part
        assert np.linalg.norm(np.delete(again - other.p_part, 0)) < 0.011  # a slide: along x
    far = (5.0, 0.0, 0.0)
    unmoved = find_hooks(world.scene, world, "object.xml", 0.15, PlanSettings(proven=((*far[:2], 5.0),)))
    assert unmoved[0].p_part == pytest.approx(hooks[0].p_part)


def test_distance_is_zero_from_the_place_to_the_touch_and_grows_elsewhere(hooks):
    hook = hooks[0]
    for share in (0.0, 0.5, 1.0):
        assert hook.distance((hook.p_part + share * hook.push_part)[None]) == pytest.approx(0.0, abs=1e-9)
    beside = np.cross(hook.R_part_tool[:, 2], hook.push_part)
    beside /= np.linalg.norm(beside)
    values = hook.distance(hook.p_part + np.array([0.005, 0.02, 0.1])[:, None] * beside)
    assert (np.diff([0.0, *values]) > 0.0).all()


def test_funnel_wants_the_fingertip_higher_beside_the_place(hooks):
    hook = hooks[0]
    away = -hook.R_part_tool[:, 2]
    beside = np.cross(away, hook.push_part)
    beside *= 0.03 / np.linalg.norm(beside)
    low, high = hook.distance(hook.p_part + beside + np.array([0.0, 0.05])[:, None] * away)
    assert high < low


def test_turn_is_the_angle_to_the_hook_s_orientation(hooks):
    hook = hooks[0]
    grip = quat_of(hook.R_part_tool)
    assert hook.place.turn(grip.tolist(), 0.1) == pytest.approx(0.0, abs=1e-6)
    assert hook.place.turn((-grip).tolist(), 0.1) == pytest.approx(0.0, abs=1e-6)
    c, s = np.cos(0.3), np.sin(0.3)
    turned = hook.R_part_tool @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert hook.place.turn(quat_of(turned).tolist(), 0.1) == pytest.approx(0.3)


@pytest.mark.parametrize("seed", range(5))
def test_inverse_kinematics_reaches_the_poses_of_other_postures(world, seed):
    rng = np.random.default_rng(seed)
    kinematics = ToolKinematics(world.scene, 0.05)
    q_goal = ARM.q_home + rng.uniform(-0.4, 0.4, 7)
    p, R = kinematics.pose(q_goal)
    q = kinematics.solve(p, R, ARM.q_home)
    assert q is not None
    p_found, R_found = kinematics.pose(q)
    assert np.linalg.norm(p_found - p) < 1e-3
    assert np.linalg.norm(rotation_errors(R_found[None], R[None])) < 1e-2


def test_inverse_kinematics_gives_up_on_poses_out_of_reach(world):
    kinematics = ToolKinematics(world.scene, 0.05)
    assert kinematics.solve(np.array([2.0, 0.0, 0.3]), np.eye(3), ARM.q_home) is None


def test_proposals_follow_the_route_with_bounded_actions():
    route = Route(np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.3]]), 0.05)
    proposals = route.proposals(np.zeros(2), 10, (1.0, 0.5))
    assert proposals.shape == (2, 10, 2)
    assert np.abs(proposals).max() <= 0.05 + 1e-12
    assert proposals[0].sum(axis=0) == pytest.approx([0.2, 0.3])
    assert proposals[1].sum(axis=0) == pytest.approx([0.2, 0.05])


def test_proposals_head_back_to_the_route_from_beside_it():
    route = Route(np.array([[0.0, 0.0], [0.4, 0.0]]), 0.05)
    first = route.proposals(np.array([0.1, 0.2]), 4, (1.0,))[0, 0]
    assert first == pytest.approx([0.05, -0.05])


OVERHEAD = """<mujoco><compiler angle="radian"/><worldbody><body pos=".1 .1 1.1">
  <geom type="box" size=".2 .2 .01" pos="0 0 .05"/>
  <body><joint name="lever" axis="0 0 1" range="-1 1" damping=".2" frictionloss=".4"/>
    <geom type="capsule" size=".012" fromto="0 0 0 .15 0 0" mass=".2"/></body></body></worldbody></mujoco>"""


def test_to_what_is_overhead_the_hand_comes_from_below(world_of):
    world = world_of(OVERHEAD, "lever")
    hooks = find_hooks(world.scene, world, "object.xml", 0.6, PlanSettings())
    axis = [(world.data.xmat[world.scene.part_body].reshape(3, 3) @ hook.R_part_tool)[2, 2] for hook in hooks]
    assert min(axis) > 0.2
