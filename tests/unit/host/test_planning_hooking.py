"""Places for the fingertip, the funnel around them, and routes through them."""

import numpy as np
import pytest

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hand_probe import HandProbe, quat_of
from s2r_host.planning.hooking import TOUCH_WAYPOINT, Hook, find_hooks
from s2r_host.planning.kinematics import ToolKinematics, rotation_errors
from s2r_host.planning.places import find_places
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


def test_places_for_pulling_are_free_and_behind_something_of_the_part(world):
    probe = HandProbe(world.scene, world.data, 1)
    places = find_places(world.scene, world.data, probe, 1.0)
    assert len(places) > 10
    quat = np.array([quat_of(R) for R in places.R])
    assert not probe.contacts(places.p, quat).any()
    pushed = places.p + places.push_m[:, None] * places.way
    assert probe.finger_contacts(pushed, quat).all()


def test_places_for_closing_are_in_front_of_the_front(world):
    places = find_places(world.scene, world.data, HandProbe(world.scene, world.data, 1), -1.0)
    assert len(places) > 10
    assert places.way[:, 0] == pytest.approx(1.0)
    assert places.p[:, 0].min() < SHAPE.x - SHAPE.opening


def test_hooks_have_joint_solutions_without_contact_from_the_touch_to_the_target(world, hooks):
    kinematics = ToolKinematics(world.scene, 0.0)
    for hook in hooks:
        p_start, p_end = (kinematics.pose(hook.route[row])[0] for row in (TOUCH_WAYPOINT, -1))
        assert p_end - p_start == pytest.approx([-0.15, 0.0, 0.0], abs=3e-3)
        assert (hook.route > ARM.limits.q_min).all()
        assert (hook.route < ARM.limits.q_max).all()


def test_distance_is_zero_from_the_place_to_the_touch_and_grows_elsewhere(hooks):
    hook = hooks[0]
    for share in (0.0, 0.5, 1.0):
        assert hook.distance(hook.p_part + share * hook.push_part) == pytest.approx(0.0, abs=1e-9)
    beside = np.cross(hook.R_part_tool[:, 2], hook.push_part)
    beside /= np.linalg.norm(beside)
    values = hook.distance(hook.p_part + np.array([0.005, 0.02, 0.1])[:, None] * beside)
    assert (np.diff([0.0, *values]) > 0.0).all()


def test_funnel_wants_the_fingertip_higher_beside_the_place(hooks):
    hook = hooks[0]
    away = -hook.R_part_tool[:, 2]
    beside = np.cross(away, hook.push_part)
    beside *= 0.03 / np.linalg.norm(beside)
    low, high = (hook.distance(hook.p_part + beside + height * away) for height in (0.0, 0.05))
    assert high < low


def test_turn_is_the_angle_to_the_hook_s_orientation(hooks):
    hook = hooks[0]
    assert hook.turn(quat_of(hook.R_part_tool), np.array(0.1)) == pytest.approx(0.0, abs=1e-6)
    assert hook.turn(-quat_of(hook.R_part_tool), np.array(0.1)) == pytest.approx(0.0, abs=1e-6)
    c, s = np.cos(0.3), np.sin(0.3)
    turned = hook.R_part_tool @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert hook.turn(quat_of(turned), np.array(0.1)) == pytest.approx(0.3)


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
