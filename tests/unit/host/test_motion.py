"""Kinematics, collision checks and pushes on a synthetic drawer in front of the arm."""

import dataclasses
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from s2r_executor.config import AdmissionConfig
from s2r_host.errors import EmptyCloudError, NoMotionError, SceneError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.cartesian import straight_line
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.escape import _ways_back, _ways_out, plan_escape
from s2r_host.motion.fingertip import CLOSED_GRIPPER, Fingertip, fingertip_of
from s2r_host.motion.front import Front, find_front
from s2r_host.motion.inverse import InverseKinematics, seeds_around
from s2r_host.motion.joint_motion import plan_joint_motion
from s2r_host.motion.obstacles import Obstacle, cloud_obstacle, table_obstacle
from s2r_host.motion.push import PART, PushScene, _advice, plan_push, push_scene
from s2r_host.motion.push_proposals import (
    PushSettings,
    handle_points,
    push_points,
    push_proposals,
    tool_orientation,
)
from s2r_host.motion.robot_mask import back_project, robot_mask
from s2r_host.motion.scene import Region, Scene, observed_scene
from s2r_protocol.arms import load_arm

SIX_JOINT_ARM = Path(__file__).parent / "six_joint_arm"
P_CAMERA = np.array([0.05, -0.45, 0.75])


@pytest.fixture(scope="module")
def arm():
    return ArmModel(load_arm("xmate3pro"))


@pytest.fixture(scope="module")
def home(arm):
    return arm.arm.q_home


def rectangle(p0, along, across, step=0.003):
    a, b = np.linalg.norm(along), np.linalg.norm(across)
    s, t = np.meshgrid(np.arange(0, 1, step / a), np.arange(0, 1, step / b))
    return p0 + s.reshape(-1, 1) * along + t.reshape(-1, 1) * across


def drawer_scene(yaw=0.15, noise_m=0.001, seed=0):
    """Cabinet front 30 x 24 cm at x = 0.62, drawer front 26 x 14 cm standing 7 cm out, bar handle on it."""
    rng = np.random.default_rng(seed)
    x, y, z = np.eye(3)
    cabinet = rectangle([0.62, -0.15, 0.01], 0.30 * y, 0.24 * z)
    hole = (np.abs(cabinet[:, 1]) < 0.13) & (cabinet[:, 2] > 0.06) & (cabinet[:, 2] < 0.20)
    parts = [
        cabinet[~hole],
        rectangle([0.62, -0.15, 0.25], 0.30 * y, 0.30 * x),
        rectangle([0.55, -0.13, 0.06], 0.26 * y, 0.14 * z),
        rectangle([0.55, -0.13, 0.20], 0.26 * y, 0.07 * x),
        rectangle([0.515, -0.05, 0.125], 0.10 * y, 0.012 * z),
        rectangle([0.515, -0.05, 0.137], 0.10 * y, 0.010 * x),
    ]
    points = np.concatenate(parts)
    R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    points = (points - [0.6, 0, 0]) @ R.T + [0.6, 0, 0]
    return Scene(points + rng.normal(0, noise_m, points.shape), P_CAMERA), R @ np.array([-1.0, 0, 0])


@pytest.fixture(scope="module")
def scene():
    return drawer_scene()


def test_inverse_kinematics_reaches_the_pose_inside_the_limits(arm, home):
    X = np.eye(4)
    X[:3, :3] = tool_orientation(np.array([1.0, 0, 0]), 1.2, 0.0, 0.0)
    X[:3, 3] = [0.5, 0.1, 0.2]
    solutions = InverseKinematics(arm).solve_any(X, seeds_around(arm, home, np.random.default_rng(0)))
    assert solutions
    for q in solutions:
        assert np.abs(arm.tool_pose(q) - X).max() < 2e-3
        assert arm.inside_limits(q)


def test_inverse_kinematics_says_none_for_a_pose_out_of_reach(arm, home):
    X = np.eye(4)
    X[:3, 3] = [2.0, 0.0, 0.3]
    assert InverseKinematics(arm).solve(X, home) is None


def test_straight_line_stays_on_the_line_and_keeps_the_orientation(arm, home):
    X = arm.tool_pose(home)
    goal = X[:3, 3] + [0.06, 0.02, -0.05]
    path = straight_line(arm, InverseKinematics(arm), home, goal)
    along = (goal - X[:3, 3]) / np.linalg.norm(goal - X[:3, 3])
    for q in path:
        Y = arm.tool_pose(q)
        off = Y[:3, 3] - X[:3, 3]
        assert np.linalg.norm(off - along * (off @ along)) < 5e-4
        assert np.abs(Y[:3, :3] - X[:3, :3]).max() < 4e-3
    assert np.linalg.norm(arm.tool_pose(path[-1])[:3, 3] - goal) < 5e-4


@pytest.mark.parametrize("description", ["xmate3pro", str(SIX_JOINT_ARM)])
def test_the_fingertip_is_never_farther_from_an_axis_than_its_lever(description):
    """Lines in joint space are looked at so often that nothing moves over a centimetre between two looks."""
    arm, rng = ArmModel(load_arm(description)), np.random.default_rng(0)
    for _ in range(500):
        q = rng.uniform(arm.arm.limits.q_min, arm.arm.limits.q_max)
        jacobian = pin.computeFrameJacobian(
            arm.model, arm.data, q, arm.tool_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        assert (np.linalg.norm(jacobian[:3], axis=0) <= arm.lever_m + 1e-9).all()


def test_tip_shapes_are_the_two_finger_pads(arm):
    assert {arm.link_of(i) for i in arm.tip_shapes} == {"gripper"}
    assert len(arm.tip_shapes) == 2


def test_home_is_free_and_a_posture_in_the_table_is_not(arm, home):
    checker = CollisionChecker(arm, [table_obstacle()])
    assert checker.is_free(home)
    assert "table" in checker.touching(np.array([0.0, 1.4, 0.0, 0.5, 0.0, 0.3, 0.0]))


def test_cloud_point_on_the_forearm_is_noticed_by_name(arm, home):
    p = arm.shape_placements(home)[-1].translation
    checker = CollisionChecker(arm, [cloud_obstacle(p[None] + np.zeros((3, 1)), name="cloud")])
    assert checker.touching(home) == "gripper against cloud"


def test_only_the_tip_may_touch_when_asked(arm, home):
    p_tip = arm.tool_pose(home)[:3, 3] + [0, 0, -0.012]
    touching = CollisionChecker(arm, [cloud_obstacle(p_tip[None])], Clearance(tip_m=None, obstacle_m=0.005))
    strict = CollisionChecker(arm, [cloud_obstacle(p_tip[None])], Clearance(tip_m=0.01, obstacle_m=0.005))
    assert touching.is_free(home)
    assert not strict.is_free(home)


def test_the_hand_alone_touches_what_the_whole_arm_does_with_it(arm, home):
    X = arm.tool_pose(home)
    rng = np.random.default_rng(0)
    seen = set()
    for _ in range(40):
        p = X[:3, 3] + X[:3, :3] @ rng.uniform((-0.1, -0.1, -0.15), (0.1, 0.1, 0.05))
        checker = CollisionChecker(arm, [cloud_obstacle(p[None], P_CAMERA)])
        whole, hand = checker.touching(home), checker.hand_touching(X)
        assert hand is None or whole is not None
        if whole is None or whole.startswith(("gripper", "finger")):
            assert (hand is None) == (whole is None)
        seen.add(hand is None)
    assert seen == {True, False}


def test_motion_around_a_wall_is_free_at_every_centimetre(arm, home):
    wall = rectangle([0.25, 0.0, 0.0], np.array([0.3, 0, 0]), np.array([0, 0, 0.42]), 0.01)
    checker = CollisionChecker(arm, [table_obstacle(), cloud_obstacle(wall)])
    q_goal = home.copy()
    q_goal[0] = -0.6
    assert not checker.line_is_free(home, q_goal)
    path = plan_joint_motion(checker, home, q_goal, np.random.default_rng(1))
    assert np.array_equal(path[0], home)
    assert np.array_equal(path[-1], q_goal)
    assert checker.path_is_free(path)


def test_motion_from_a_blocked_start_names_what_blocks(arm, home):
    p = arm.tool_pose(home)[:3, 3]
    checker = CollisionChecker(arm, [cloud_obstacle(p[None], name="cup")])
    with pytest.raises(NoMotionError, match="start posture is not free: gripper against cup"):
        plan_joint_motion(checker, home, home + 0.1, np.random.default_rng(0))


def test_front_is_the_drawer_and_not_the_cabinet_behind_it(scene):
    points, normal = scene
    front = find_front(points)
    assert np.degrees(np.arccos(front.normal @ normal)) < 1.0
    assert front.offset_m == pytest.approx(normal @ [0.6, 0, 0] + 0.05, abs=1e-3)
    assert front.area_m2 == pytest.approx(0.26 * 0.14, rel=0.35)
    assert len(front.p_handle) > 20


def test_scene_without_upright_plane_is_refused():
    flat = rectangle([0.4, -0.2, 0.05], np.array([0.4, 0, 0]), np.array([0, 0.4, 0]))
    with pytest.raises(SceneError, match="no upright plane"):
        find_front(Scene(flat, P_CAMERA))


def test_push_points_keep_away_from_handle_and_edges(scene):
    points, _ = scene
    front = find_front(points)
    settings = PushSettings()
    chosen = push_points(front, settings)
    assert len(chosen) > 3
    flat, handle = front.in_plane(chosen), front.in_plane(front.p_handle)
    assert min(np.linalg.norm(handle - p, axis=1).min() for p in flat) > settings.handle_margin_m
    low, high = front.in_plane(front.p_plane).min(axis=0), front.in_plane(front.p_plane).max(axis=0)
    assert np.all(flat > low + 0.015)
    assert np.all(flat < high - 0.015)


def test_proposals_touch_the_plane_with_their_foremost_corner(scene):
    front = find_front(scene[0])
    for proposal, _ in zip(push_proposals(front), range(40), strict=False):
        R = proposal.X_base_tool[:3, :3]
        corners = [proposal.p_contact + R @ [a * 0.0135, b * 0.0075, 0] for a in (-1, 1) for b in (-1, 1)]
        ahead = max(corner @ proposal.direction for corner in corners)
        assert ahead == pytest.approx(-front.offset_m, abs=1e-9)
        assert np.linalg.norm(proposal.p_end - proposal.p_contact) == pytest.approx(0.045)


def test_the_fingertip_is_as_large_as_the_arms_description_says(arm):
    shipped = fingertip_of(arm)
    assert shipped.width_m == pytest.approx(CLOSED_GRIPPER.width_m, abs=1e-4)
    assert shipped.depth_m == pytest.approx(CLOSED_GRIPPER.depth_m, abs=1e-4)
    round_one = fingertip_of(ArmModel(load_arm(str(SIX_JOINT_ARM))))
    assert (round_one.width_m, round_one.depth_m) == pytest.approx((0.016, 0.016))  # a rod of 8 mm radius


def test_a_wider_fingertip_begins_its_push_further_back():
    front = find_front(drawer_scene()[0])
    narrow, wide = (
        next(push_proposals(front, PushSettings(tip=tip))) for tip in (Fingertip(), Fingertip(0.06, 0.05))
    )
    R, direction = narrow.X_base_tool[:3, :3], narrow.direction
    further_m = abs(R[:, 0] @ direction) * 0.033 / 2 + abs(R[:, 1] @ direction) * 0.035 / 2
    assert further_m > 0.005
    assert (narrow.p_contact - wide.p_contact) @ direction == pytest.approx(further_m)


def test_a_handle_is_pressed_on_its_outermost_face_last(scene):
    front = find_front(scene[0])
    outermost = (front.p_handle @ front.normal).max()
    points = handle_points(front)
    assert np.all(np.abs(points @ front.normal - outermost) < 0.006)
    flat, handle = front.in_plane(points), front.in_plane(front.p_handle)
    assert np.all((flat > handle.min(axis=0) - 1e-9) & (flat < handle.max(axis=0) + 1e-9))

    proposals = list(push_proposals(front))
    on_handle = [p for p in proposals if (p.p_contact @ front.normal) > 0.5 * (outermost + front.offset_m)]
    assert on_handle == proposals[-len(on_handle) :]
    R = on_handle[0].X_base_tool[:3, :3]
    corners = [
        on_handle[0].p_contact + R @ [a * 0.0135, b * 0.0075, 0] for a in (-1, 0, 1) for b in (-1, 0, 1)
    ]
    assert min(np.linalg.norm(corner - points[0]) for corner in corners) < 1e-9


def test_a_front_without_handle_is_pressed_on_its_plane_alone(scene):
    front = find_front(scene[0])
    bare = Front(front.normal, front.offset_m, front.p_plane, front.p_handle[:0], front.area_m2)
    assert len(handle_points(bare)) == 0
    heights = np.array([p.p_contact @ front.normal - front.offset_m for p in push_proposals(bare)])
    assert len(heights) > 0
    assert np.all(heights < 0.02)


def test_a_drawer_in_front_of_the_arm_can_be_pushed(arm, home, scene):
    points, _ = scene
    front = find_front(points)
    parts = push_scene(points, front)
    motion = plan_push(arm, parts, push_proposals(front), home, home, np.random.default_rng(0))
    assert np.array_equal(motion.approach[0], home)
    assert np.array_equal(motion.approach[-1], motion.push[0])
    assert np.array_equal(motion.home[-1], home)
    tip = arm.tool_pose(motion.push[-1])[:3, 3]
    assert np.linalg.norm(tip - motion.proposal.p_end) < 5e-4
    again = plan_push(arm, parts, push_proposals(front), home, home, np.random.default_rng(0))
    assert np.array_equal(motion.push, again.push)


def test_the_way_home_is_free_where_the_part_was_found_and_where_it_is_pushed_to(arm, home, scene):
    """A place to end at that only the pushed part takes is none to go home to."""
    front = find_front(scene[0])
    drawer = push_scene(scene[0], front)
    proposal = plan_push(arm, drawer, push_proposals(front), home, home, np.random.default_rng(0)).proposal
    X = np.eye(4)  # a plate in the open, across the push
    X[:2, :2] = [
        [proposal.direction[0], -proposal.direction[1]],
        [proposal.direction[1], proposal.direction[0]],
    ]
    X[:3, 3] = proposal.p_contact + 0.011 * proposal.direction
    plate = PushScene((table_obstacle(),), Obstacle(PART, coal.Box(0.02, 0.15, 0.15), X))
    motion, rng = (
        plan_push(arm, plate, [proposal], home, home, np.random.default_rng(0)),
        np.random.default_rng(1),
    )
    found, pushed = CollisionChecker(arm, plate.all), CollisionChecker(arm, plate.all)
    pushed.place(PART, float((proposal.p_end - proposal.p_contact) @ proposal.direction) * proposal.direction)
    assert pushed.path_is_free(motion.home)
    near = (motion.push[0] + rng.uniform(-0.4, 0.4, 7) for _ in range(20_000))
    taken = next(q for q in near if arm.inside_limits(q) and found.is_free(q) and not pushed.is_free(q))
    with pytest.raises(
        NoMotionError, match=r"way home: the goal posture is not free: .* against pushed part"
    ):
        plan_push(arm, plate, [proposal], home, taken, np.random.default_rng(0))


def test_a_half_hidden_front_is_refused_with_what_was_seen_of_it():
    points, _ = drawer_scene()
    front = find_front(points)
    near = np.abs(points.p_base @ front.normal - front.offset_m) < 0.005
    strip = np.abs(points.p_base[:, 2] - front.p_plane[:, 2].mean()) < 0.005
    beside = np.abs(points.p_base[:, 1] - front.p_plane[:, 1].mean()) < 0.1
    with pytest.raises(SceneError, match=r"\d+ cm² of what was seen do, .* clear the camera's view of it"):
        find_front(Scene(points.p_base[near & strip & beside], P_CAMERA))


def test_a_drawer_out_of_reach_is_refused_with_counted_reasons(arm, home):
    points, _ = drawer_scene()
    far = Scene(points.p_base + np.array([1.0, 0, 0]), P_CAMERA)
    front = find_front(far)
    with pytest.raises(NoMotionError, match=r"none of \d+ push proposals.*no posture"):
        plan_push(
            arm,
            push_scene(far, front),
            push_proposals(front, max_points=2),
            home,
            home,
            np.random.default_rng(0),
        )


def test_the_advice_follows_from_why_proposals_fell_out():
    blocked, far = "stand-off not free (gripper_housing, cell_7)", "straight push out of reach"
    assert _advice({blocked: 3, far: 2}).startswith("make room for the hand")
    assert _advice({blocked: 2, far: 3}).startswith("move the object closer")


def test_no_proposal_left_is_said_as_such(arm, home):
    points, _ = drawer_scene()
    parts = push_scene(points, find_front(points))
    with pytest.raises(NoMotionError, match=r"no push proposal is left.*sees more of the part"):
        plan_push(arm, parts, iter(()), home, home, np.random.default_rng(0))


def test_escape_backs_off_before_it_leaves_a_gap(arm, home):
    import coal

    X = arm.tool_pose(home)
    tip = X[:3, 3]
    bar, front = np.eye(4), np.eye(4)
    bar[:3, 3] = tip + np.array([-0.021, 0, 0.01])
    front[:3, 3] = tip + np.array([0.04, 0, 0.01])
    shapes = [
        Obstacle("handle", coal.Box(0.012, 0.2, 0.012), bar),
        Obstacle("front", coal.Box(0.02, 0.3, 0.12), front),
        table_obstacle(),
    ]
    q_away = home + np.array([0.8, 0, 0, 0, 0, 0, 0])
    escape = plan_escape(arm, shapes, shapes, home, q_away, np.array([-1.0, 0, 0]), np.random.default_rng(0))
    tight = CollisionChecker(arm, shapes, Clearance(obstacle_m=0.001, tip_m=0.001))
    assert np.array_equal(escape.out[0], home)
    assert tight.path_is_free(escape.out[3:])
    assert np.linalg.norm(arm.tool_pose(escape.out[-1])[:3, 3] - tip) > 0.04


@pytest.mark.parametrize("push", [[0.0, 0.0, -1.0], [0.03, 0.0, -1.0], [1.0, 0.0, 0.0]])
def test_escape_tries_places_aside_of_a_push_however_steep(arm, home, push):
    ik, tight = InverseKinematics(arm), CollisionChecker(arm, [table_obstacle()])
    direction = np.array(push) / np.linalg.norm(push)
    p = arm.tool_pose(home)[:3, 3]
    beside = [arm.tool_pose(way[-1])[:3, 3] - p for way in _ways_back(arm, ik, tight, home, direction)]
    across = np.linalg.norm(np.array(beside) - np.outer(beside @ direction, direction), axis=1)
    assert across.max() == pytest.approx(0.012, abs=5e-4)
    ways = list(_ways_out(arm, ik, tight, home, direction))
    assert all(np.isfinite(way).all() for way in ways)


def test_a_boxed_in_tip_leaves_the_way_it_came(arm, home):
    """A slot that is open upwards only, and not where the straight ways begin."""
    import coal

    X = arm.tool_pose(home)
    ik = InverseKinematics(arm)
    way_out = straight_line(arm, ik, home, X[:3, 3] + [0.0, 0.0, 0.13])
    walls = []
    for k, (x, y, size) in enumerate(
        [(-0.0192, 0, (0.01, 0.12, 0.03)), (0.0192, 0, (0.01, 0.12, 0.03)), (0, 0.0245, (0.05, 0.01, 0.03)),
         (0, -0.0245, (0.05, 0.01, 0.03))]
    ):  # fmt: skip
        pose = np.eye(4)
        pose[:3, 3] = X[:3, 3] + np.array([x, y, 0.0])
        walls.append(Obstacle(f"wall{k}", coal.Box(*size), pose))
    obstacles = [*walls, table_obstacle()]
    rng = np.random.default_rng(0)
    away = home + np.array([0.8, 0, 0, 0, 0, 0, 0])
    escape = plan_escape(
        arm,
        obstacles,
        obstacles,
        home,
        away,
        np.array([-1.0, 0, 0]),
        rng,
        way_in=way_out[::-1],
        carried=np.eye(4),
    )
    assert escape.clearance_m == 0.0  # none of the straight ways, which all keep at least a millimetre
    checker = CollisionChecker(arm, obstacles, Clearance(obstacle_m=0.0, tip_m=0.0))
    assert checker.path_is_free(escape.out[3:])
    assert arm.tool_pose(escape.out[-1])[2, 3] > X[2, 3] + 0.04


@dataclasses.dataclass(frozen=True)
class View:
    depth_m: np.ndarray
    K: np.ndarray
    X_base_camera: np.ndarray


def view_of(points, shape=(120, 160), f=110.0):
    """Nearest-point depth image of a point set, seen from the side of the arm."""
    z = np.array([0.45, 0.0, 0.25]) - P_CAMERA
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    X = np.eye(4)
    X[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    X[:3, 3] = P_CAMERA
    local = (points - P_CAMERA) @ X[:3, :3]
    u = np.round(local[:, 0] / local[:, 2] * f + shape[1] / 2).astype(int)
    v = np.round(local[:, 1] / local[:, 2] * f + shape[0] / 2).astype(int)
    depth = np.full(shape, np.inf)
    inside = (u >= 0) & (u < shape[1]) & (v >= 0) & (v < shape[0]) & (local[:, 2] > 0.05)
    np.minimum.at(depth, (v[inside], u[inside]), local[inside, 2])
    depth[~np.isfinite(depth)] = 0.0
    return View(
        depth.astype(np.float32), np.array([[f, 0, shape[1] / 2], [0, f, shape[0] / 2], [0, 0, 1.0]]), X
    )


def test_back_projection_puts_points_where_they_were(scene):
    points, _ = scene
    view = view_of(points.p_base)
    p = back_project(view)
    p = p[np.isfinite(p[..., 0])]
    from scipy.spatial import cKDTree

    assert cKDTree(points.p_base).query(p)[0].max() < 0.012


def test_robot_mask_covers_the_arm_and_nothing_else(arm, home, scene):
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    on_arm = np.concatenate([p.translation + 0.015 * directions for p in arm.shape_placements(home)[-14:]])
    view = view_of(np.concatenate([scene[0].p_base, on_arm]))
    only_arm = view_of(on_arm)
    mask = robot_mask(arm, home, view)
    arm_pixels = (only_arm.depth_m > 0) & np.isclose(view.depth_m, only_arm.depth_m)
    assert mask[arm_pixels].mean() > 0.95
    object_pixels = (view.depth_m > 0) & ~arm_pixels
    assert mask[object_pixels].mean() < 0.02


def test_empty_cloud_is_refused_with_the_counts():
    view = View(np.zeros((60, 80), np.float32), np.diag([60.0, 60.0, 1.0]), np.eye(4))
    with pytest.raises(EmptyCloudError, match=r"shows 0 points.*0 of 4800 pixels"):
        observed_scene(view)


def test_region_leaves_out_the_table_and_far_walls():
    region = Region()
    points = np.array([[0.5, 0, 0.1], [0.5, 0, 0.001], [3.0, 0, 0.1], [np.nan, 0, 0]])
    assert region.contains(points).tolist() == [True, False, False, False]


def test_the_fingertip_is_what_the_description_calls_so_however_long_it_is(arm):
    six = ArmModel(load_arm(Path(__file__).parent / "six_joint_arm"))
    shapes = [six.shapes.geometryObjects[i].name for i in sorted(six.tip_shapes)]
    assert shapes == ["finger_1", "finger_2", "finger_3"]  # the rod and both its round ends, not the holder
    assert len(arm.tip_shapes) == 2


def test_a_base_of_another_name_may_stand_on_the_table(tmp_path):
    text = (Path(__file__).parent / "six_joint_arm/arm.yaml").read_text()
    text = text.replace("base: base", "base: foot").replace("parent: base", "parent: foot")
    text = text.replace("link: base", "link: foot").replace("name: base,", "name: foot,")
    (tmp_path / "arm.yaml").write_text(text.replace("[base, upper_arm]", "[foot, upper_arm]"))
    six = ArmModel(load_arm(tmp_path))
    assert CollisionChecker(six, (table_obstacle(),)).touching(six.arm.q_home) is None


def test_links_stay_as_far_from_each_other_as_admission_asks_for():
    assert Clearance().self_m > 2 * AdmissionConfig().collision_inflation_m
