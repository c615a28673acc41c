"""A lid is found in one view, with its hinge, its angle and the side it was seen from; pushes keep that in view."""

import numpy as np
import pytest

from s2r_host.errors import SceneError
from s2r_host.motion.lid import find_lid
from s2r_host.motion.lid_proposals import LidPushSettings, lid_proposals
from s2r_host.motion.scene import observed_scene
from s2r_host.perception.motion import JointMotion, rotation
from s2r_host.perception.synthetic import Box, look_at, pair

K = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]])
SHAPE = (360, 640)
DEPTH_M, WIDTH_M, BASE_M = 0.23, 0.33, 0.02
YAW = 0.2


def laptop(angle):
    """(scene, hinge direction, hinge point) of a laptop opened by ``angle`` [rad], its user's side at the robot.

    The camera looks down on a lid that is nearly shut: from the usual place it would see it edge-on.
    """
    p_camera = (0.1, -0.3, 0.9) if angle < np.radians(50) else (-0.04, -0.45, 0.6)
    R = rotation(np.array([0.0, 0, 1]), np.pi + YAW)  # x of the laptop looks at the robot
    p = np.array([0.72, 0.0, 0.0])

    def box(low, high, R_local=None, pivot=(0.0, 0.0, 0.0)):
        low, high, pivot = np.array(low), np.array(high), np.array(pivot)
        X = np.eye(4)
        R_local = np.eye(3) if R_local is None else R_local
        X[:3, :3] = R @ R_local
        X[:3, 3] = p + R @ (pivot + R_local @ ((low + high) / 2 - pivot))
        return Box(X, high - low)

    table = Box(
        np.eye(4) + np.pad(np.array([[0.7, 0, -0.01]]).T, ((0, 1), (3, 0))), np.array([1.6, 1.6, 0.02])
    )
    pivot = np.array([0.0, 0.0, BASE_M])
    opened = rotation(np.array([0.0, -1.0, 0.0]), angle)
    lid = box((0.003, -WIDTH_M / 2, BASE_M), (DEPTH_M, WIDTH_M / 2, BASE_M + 0.008), opened, pivot)
    static = [table, box((0, -WIDTH_M / 2, 0), (DEPTH_M, WIDTH_M / 2, BASE_M)), lid]
    still = JointMotion("revolute", p, np.array([0.0, 0, 1]), 0.0)
    X_WC = look_at(np.array(p_camera), np.array([0.65, 0.0, 0.1]))
    frame = pair(static, [], still, K, SHAPE, X_WC, np.random.default_rng(0)).before
    return observed_scene(frame), R @ np.array([0.0, -1.0, 0.0]), p + R @ pivot


@pytest.mark.parametrize("degrees", [40, 60, 95, 115])
def test_hinge_and_angle_of_a_lid_are_found(degrees):
    scene, along, p_hinge = laptop(np.radians(degrees))
    lid = find_lid(scene)
    assert lid.along @ along > np.cos(np.radians(4.0))
    assert np.degrees(lid.angle_rad) == pytest.approx(degrees, abs=4.0)
    assert np.linalg.norm(np.cross(lid.p_hinge - p_hinge, along)) < 0.02
    assert lid.length_m == pytest.approx(DEPTH_M, abs=0.025)


@pytest.mark.parametrize(("degrees", "outside"), [(40, True), (100, False)])
def test_the_side_that_was_seen_is_known(degrees, outside):
    assert find_lid(laptop(np.radians(degrees))[0]).outside_seen is outside


def test_a_lid_covers_itself_and_not_its_base():
    scene, *_ = laptop(np.radians(95))
    covered = find_lid(scene).covers(scene.p_base)
    assert np.all(scene.p_base[covered][:, 2] > BASE_M)
    assert np.mean(covered[scene.p_base[:, 2] > 0.08]) > 0.9


@pytest.mark.parametrize("degrees", [80, 100])
def test_the_first_push_shuts_the_lid_by_a_useful_angle(degrees):
    scene, along, p_hinge = laptop(np.radians(degrees))
    push = next(iter(lid_proposals(find_lid(scene))))
    arm = push.p_contact - p_hinge
    turning = np.cross(arm, push.direction) @ along  # moment about the opening axis
    assert turning < -0.1
    turn = np.linalg.norm(push.p_end - push.p_contact) / np.linalg.norm(arm - (arm @ along) * along)
    assert turn > np.radians(15.0)


def test_a_lid_that_is_nearly_shut_is_pushed_open():
    lid = find_lid(laptop(np.radians(40))[0])
    settings = LidPushSettings(least_angle_rad=np.radians(50))
    assert next(iter(lid_proposals(lid, settings))).direction @ lid.opening > 0.99


def test_a_lid_that_closing_would_turn_from_the_camera_is_pushed_open():
    lid = find_lid(laptop(np.radians(52))[0])
    assert lid.facing(-0.4) < 0.15 < lid.facing(0.4)
    assert next(iter(lid_proposals(lid))).direction @ lid.opening > 0.99


def test_facing_is_the_cosine_to_the_camera_and_changes_sign_edge_on():
    lid = find_lid(laptop(np.radians(80))[0])
    turns = np.radians(np.arange(-80, 81))
    cosines = np.array([lid.facing(turn) for turn in turns])
    assert np.all(np.abs(cosines) <= 1.0)
    assert np.count_nonzero(np.diff(np.sign(cosines))) == 1
    assert cosines[80] > 0.5


def test_a_table_with_a_box_has_no_lid():
    table = Box(np.eye(4), np.array([1.6, 1.6, 0.02]))
    X = np.eye(4)
    X[:3, 3] = [0.65, 0.0, 0.03]
    still = JointMotion("revolute", X[:3, 3], np.array([0.0, 0, 1]), 0.0)
    X_WC = look_at(np.array([-0.04, -0.3, 0.8]), np.array([0.65, 0.0, 0.05]))
    frame = pair(
        [table, Box(X, np.array([0.2, 0.2, 0.04]))], [], still, K, SHAPE, X_WC, np.random.default_rng(0)
    ).before
    with pytest.raises(SceneError, match="no lid in view"):
        find_lid(observed_scene(frame))
