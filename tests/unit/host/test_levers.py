"""A lever is told from the spout it stands beside, and pushed across its line from free space."""

import numpy as np
import pytest

from s2r_host.errors import SceneError
from s2r_host.motion.lever_axes import level_axis, upright_axis
from s2r_host.motion.lever_proposals import SHORT, LeverPushSettings, lever_proposals
from s2r_host.motion.levers import find_levers, levers_in
from s2r_host.motion.scene import Scene, observed_scene
from s2r_host.motion.standing import deck_height
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.synthetic import Box, beam, faucet_view, look_at, pair

K = np.array([[600.0, 0, 320], [0, 600.0, 180], [0, 0, 1]])
SHAPE = (360, 640)
FOOT = np.array([0.6, 0.0, 0.0])


def faucet(yaw):
    """(scene, direction of the lever) of a column with a spout towards the robot and a lever on top."""
    view = faucet_view(np.random.default_rng(0), yaw)
    level = (view.p_tip - view.p_root) * (1.0, 1.0, 0.0)
    return observed_scene(view.frame), level / np.linalg.norm(level)


@pytest.mark.parametrize("degrees", [45, 90, -60, 120])
def test_the_lever_is_the_likeliest_candidate(degrees):
    scene, out = faucet(np.radians(degrees))
    lever = find_levers(scene)[0]
    assert lever.direction[:2] @ out[:2] > np.cos(np.radians(15.0))
    assert lever.p_tip[2] == pytest.approx(0.21, abs=0.02)
    assert lever.outward @ out > np.cos(np.radians(15.0))


@pytest.mark.parametrize("degrees", [60, 90, 120])
def test_a_lever_that_hardly_sticks_out_of_the_column_leads_straight_away_from_it(degrees):
    view = faucet_view(np.random.default_rng(0), np.radians(degrees), lever_m=0.07)
    out = (view.p_tip - view.p_root)[:2] / 0.07
    stubs = [lever for lever in find_levers(observed_scene(view.frame)) if lever.direction[:2] @ out > 0.9]
    assert stubs
    assert np.linalg.norm(stubs[0].p_tip - view.p_tip) < 0.02
    assert np.linalg.norm(stubs[0].p_root - view.p_root) < 0.03


def test_a_deck_is_found_under_what_stands_on_it():
    """A block 9 cm deep with a row of three round feet: no free square of 5 cm is left of its top."""
    x, y = np.meshgrid(np.arange(0.55, 0.64, 0.002), np.arange(-0.15, 0.15, 0.002))
    top = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.10)])
    posts = []
    for middle in (-0.1, 0.0, 0.1):
        from_post = np.linalg.norm(top[:, :2] - (0.595, middle), axis=1)
        posts += [np.column_stack([top[from_post < 0.028][:, :2], np.full((from_post < 0.028).sum(), 0.15)])]
        top = top[from_post >= 0.028]
    wall = np.column_stack(
        [np.full(4000, 0.55), *np.random.default_rng(0).uniform((-0.15, 0), (0.15, 0.1), (4000, 2)).T]
    )
    assert deck_height(np.concatenate([top, *posts, wall])) == pytest.approx(0.10, abs=0.012)


def test_a_lever_is_pushed_across_its_line_from_free_space():
    scene, out = faucet(np.pi / 2)
    lever = find_levers(scene)[0]
    settings = LeverPushSettings()
    some = list(lever_proposals(lever, upright_axis(lever), settings))
    assert {round(float(np.linalg.norm(p.direction)), 6) for p in some} == {1.0}
    assert all(abs(p.direction @ out) < 0.35 for p in some)
    assert {bool(p.direction @ some[0].direction > 0) for p in some} == {True, False}
    for p in some:
        way = float((p.p_end - p.p_contact) @ p.direction)
        assert SHORT.depth_m[0] <= way <= settings.depth_m[1]
        start = p.X_base_tool[:3, 3]
        assert (lever.p_root - start) @ p.direction > settings.standoff_m
        R = p.X_base_tool[:3, :3]
        assert np.allclose(R.T @ R, np.eye(3), atol=1e-9)
        assert R[2, 2] < SHORT.highest


def test_short_pushes_come_last_and_some_of_them_from_below():
    scene, _ = faucet(np.pi / 2)
    lever = find_levers(scene)[0]
    some = list(lever_proposals(lever, upright_axis(lever)))
    up = np.array([p.X_base_tool[2, 2] for p in some])
    way = np.array([float((p.p_end - p.p_contact) @ p.direction) for p in some])
    short = way < 0.75 * way[0]
    first = int(np.argmax(short))
    assert short[first:].all()
    assert up[:first].max() < 0.0
    assert up[first:].max() > 0.2


def test_near_its_axis_a_lever_is_pushed_in_its_inner_third_and_nowhere_else():
    scene, _ = faucet(np.pi / 2)
    lever = find_levers(scene)[0]
    line = (lever.p_tip - lever.p_root) / ((lever.p_tip - lever.p_root) @ (lever.p_tip - lever.p_root))

    def shares(near):
        some = lever_proposals(lever, upright_axis(lever), LeverPushSettings(near_axis=near))
        across = [p.p_contact + 0.5 * lever.width_m * p.direction for p in some]
        return np.array([(p - lever.p_root) @ line for p in across])

    assert np.median(shares(near=False)) > 0.5
    assert len(shares(near=True)) > 20
    assert np.median(shares(near=True)) < 0.35
    assert shares(near=True).max() < 0.5


def test_a_lever_that_swings_upright_is_pushed_square_to_its_line_in_that_plane():
    scene, out = faucet(np.pi / 2)
    lever = find_levers(scene)[0]
    line = level_axis(lever).way(lever.p_tip)
    assert abs(line @ lever.direction) < 1e-9
    assert abs(line @ np.cross([0.0, 0.0, 1.0], out)) < 0.2
    some = list(lever_proposals(lever, level_axis(lever)))
    assert all(abs(p.direction @ line) == pytest.approx(1.0) for p in some)
    assert {bool(p.direction[2] > 0.0) for p in some} == {True, False}
    for p in some:
        R = p.X_base_tool[:3, :3]
        assert np.allclose(R.T @ R, np.eye(3), atol=1e-9)
        assert R[2, 2] < SHORT.highest


@pytest.mark.parametrize("degrees", [60, 90, 120])
def test_a_push_is_as_long_as_the_turn_about_the_axis_of_the_body_asks_for(degrees):
    """What is seen of the lever begins 4 cm from its axis: pushes measured from there turned it half as far."""
    scene, _ = faucet(np.radians(degrees))
    lever, settings = find_levers(scene)[0], LeverPushSettings()
    push = next(lever_proposals(lever, upright_axis(lever), settings))
    way = float((push.p_end - push.p_contact) @ push.direction) - settings.give_m
    radius = float(np.linalg.norm((push.p_contact - FOOT)[:2]))
    assert way / radius == pytest.approx(settings.turn_rad, rel=0.15)


def test_a_bare_post_has_no_lever():
    rng = np.random.default_rng(1)
    angle, z = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0.0, 0.2, 4000)
    post = np.column_stack([0.6 + 0.02 * np.cos(angle), 0.02 * np.sin(angle), z])
    with pytest.raises(SceneError, match="no lever in view"):
        find_levers(Scene(post, np.array([0.0, -0.45, 0.55])))


def test_a_handle_apart_from_the_body_is_rooted_where_it_stands_not_where_it_comes_near_the_body():
    table, deck = np.eye(4), np.eye(4)
    table[:3, 3], deck[:3, 3] = (0.7, 0.0, -0.01), np.add(FOOT, (0.0, 0.0, 0.006))
    foot = np.add(FOOT, (0.0, 0.16, 0.0))
    head, out = np.add(foot, (0.0, 0.0, 0.04)), np.array([-0.8, -0.6, 0.0])
    static = [
        Box(table, np.array([1.6, 1.6, 0.02])),
        Box(deck, np.array([0.16, 0.44, 0.012])),
        beam(FOOT, np.add(FOOT, (0.0, 0.0, 0.09)), 0.05, 0.05),
        beam(foot, head, 0.03, 0.03),
        beam(head, head + 0.13 * out + (0, 0, 0.03), 0.02, 0.012),
    ]
    still = JointMotion("revolute", FOOT, np.array([0.0, 0, 1]), 0.0)
    X_WC = look_at(np.array((0.0, -0.45, 0.55)), np.add(FOOT, (0.0, 0.0, 0.1)))
    scene = observed_scene(pair(static, [], still, K, SHAPE, X_WC, np.random.default_rng(0)).before)
    lever = min(find_levers(scene), key=lambda c: float(np.linalg.norm(c.p.mean(axis=0) - head)))
    assert np.linalg.norm(lever.p_root - head) < 0.04
    assert np.linalg.norm(lever.p_tip - FOOT) < np.linalg.norm(
        lever.p_root - FOOT
    )  # the tip is nearer to the body
    assert lever.outward @ out > np.cos(np.radians(15.0))


def across_the_body():
    """Pieces of a tap whose one handle leads up to its body and whose spout leads down, and the handle's head."""
    table, deck = np.eye(4), np.eye(4)
    table[:3, 3], deck[:3, 3] = (0.7, 0.0, -0.01), np.add(FOOT, (0.0, 0.0, 0.006))
    foot, top = np.add(FOOT, (0.0, -0.16, 0.0)), np.add(FOOT, (0.0, 0.0, 0.09))
    head = np.add(foot, (0.0, 0.0, 0.03))
    static = [
        Box(table, np.array([1.6, 1.6, 0.02])),
        Box(deck, np.array([0.16, 0.44, 0.012])),
        beam(FOOT, top, 0.04, 0.04),
        beam(foot, head, 0.03, 0.03),
        beam(head, np.add(head, (-0.03, 0.13, 0.06)), 0.02, 0.012),
        beam(top, np.add(FOOT, (-0.14, 0.0, 0.047)), 0.02, 0.02),
    ]
    still = JointMotion("revolute", FOOT, np.array([0.0, 0, 1]), 0.0)
    X_WC = look_at(np.array((0.0, -0.45, 0.55)), np.add(FOOT, (0.0, 0.0, 0.1)))
    scene = observed_scene(pair(static, [], still, K, SHAPE, X_WC, np.random.default_rng(0)).before)
    return find_levers(scene), head


def test_a_handle_that_leads_up_to_the_body_stands_on_its_own_foot():
    found, head = across_the_body()
    handle = min(found, key=lambda c: float(np.linalg.norm(c.p.mean(axis=0) - head)))
    assert handle.rooted
    assert np.linalg.norm(handle.p_root - head) < 0.03
    assert handle.direction @ np.array([-0.2, 0.89, 0.41]) > np.cos(np.radians(15.0))


def test_a_spout_that_leads_down_close_to_the_deck_stands_on_nothing():
    found, _ = across_the_body()
    spouts = [one for one in found if abs(one.p.mean(axis=0)[1]) < 0.03]
    assert min(float(one.p_tip[2]) for one in spouts) < 0.052  # as low as the foot of a handle
    assert not any(one.rooted for one in spouts)


def slab(x, y, z, step=0.002):
    """Points of a level surface, ``x`` and ``y`` from and to [m]."""
    at = np.meshgrid(np.arange(*x, step), np.arange(*y, step))
    return np.column_stack([at[0].ravel(), at[1].ravel(), np.full(at[0].size, z)])


def plate_with(*others):
    """A thin plate with a round column in its middle, and other surfaces."""
    plate = slab((0.57, 0.63), (-0.15, 0.15), 0.010)
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.arange(0.010, 0.15, 0.002))
    column = np.column_stack(
        [0.6 + 0.02 * np.cos(angle.ravel()), 0.02 * np.sin(angle.ravel()), height.ravel()]
    )
    return Scene(np.concatenate([plate, column, *others]), np.array([0.0, -0.45, 0.55]))


def lying(scene):
    return [lever for lever in levers_in(scene) if lever.p[:, 2].max() < 0.03]


def test_a_lever_that_lies_on_a_thin_plate_is_found():
    (lever,) = lying(plate_with(slab((0.59, 0.61), (0.07, 0.15), 0.022, 0.0015)))
    assert abs(lever.direction[1]) > 0.99
    assert lever.rooted
    assert lever.width_m == pytest.approx(0.02, abs=0.004)


def test_the_rim_of_a_plate_and_the_foot_of_a_post_are_no_levers():
    rim = slab((0.57, 0.574), (-0.15, 0.15), 0.017)
    foot = slab((0.59, 0.61), (0.07, 0.15), 0.022, 0.0015)
    post = [slab((0.595, 0.605), (0.10, 0.12), z) for z in np.arange(0.022, 0.09, 0.002)]
    assert not lying(plate_with(rim))
    assert not lying(plate_with(foot, *post))
