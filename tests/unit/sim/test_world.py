"""Hidden worlds: drawing, files, commitments."""

import json
from pathlib import Path

import numpy as np
import pytest

from s2r_protocol.arms import load_arm
from s2r_sim.errors import WorldFileError
from s2r_sim.world import WorldSpec, draw_world, load_world

SEEDS = range(40)


def test_world_survives_its_file(tmp_path):
    world = draw_world(3)
    world.save(tmp_path / "world.json")
    assert load_world(tmp_path / "world.json") == world


def test_same_seed_draws_the_same_world():
    assert draw_world(3, salt="a") == draw_world(3, salt="a")
    assert draw_world(3, salt="a").object != draw_world(4, salt="a").object


def test_another_arm_gets_friction_for_its_joints_and_the_same_object():
    six = load_arm(Path(__file__).parents[1] / "host/six_joint_arm")
    world, usual = draw_world(3, salt="a", arm=six), draw_world(3, salt="a")
    assert (world.object, world.camera) == (usual.object, usual.camera)
    assert usual == draw_world(3, salt="a", arm=load_arm("xmate3pro"))
    share = np.array(world.arm.coulomb_Nm) / six.limits.tau_max
    assert share.shape == (6,)
    assert ((share > 0.004) & (share < 0.023)).all()
    assert len(world.arm.viscous_Nms_rad) == len(world.arm.link_mass_scale) == 6


def test_commitment_hides_behind_a_fresh_salt():
    assert draw_world(3).commitment != draw_world(3).commitment


def test_commitment_is_the_same_after_reading_back(tmp_path):
    world = draw_world(3)
    world.save(tmp_path / "world.json")
    assert load_world(tmp_path / "world.json").commitment == world.commitment


def test_changed_world_breaks_the_commitment():
    world = draw_world(3, salt="a")
    lighter = world.model_copy(update={"object": world.object.model_copy(update={"mass_kg": 0.8})})
    assert lighter.commitment != world.commitment


@pytest.mark.parametrize("seed", SEEDS)
def test_drawn_parameters_stay_in_their_ranges(seed):
    world = draw_world(seed, salt="a")
    drawer, camera = world.object, world.camera
    assert 0.05 <= drawer.opening_m <= 0.10
    assert 0.30 <= drawer.range_m <= 0.38
    assert drawer.opening_m - 0.03 > 0  # the first push has room
    assert drawer.opening_m + 0.15 < drawer.range_m
    assert 1.0 <= drawer.coulomb_N <= 6.0
    assert 0.8 <= drawer.mass_kg <= 4.0
    assert abs(drawer.yaw_rad) <= np.deg2rad(10)
    assert 0.032 <= drawer.handle_gap_m <= 0.045
    face = drawer.x_front_m - drawer.opening_m - drawer.front_thickness_m
    assert 0.55 <= face <= 0.66
    assert drawer.handle_drop_m < drawer.front_height_m < drawer.height_m
    assert np.linalg.norm(camera.hand_eye_m) <= 0.002 + 1e-6
    assert np.linalg.norm(camera.hand_eye_rad) <= np.deg2rad(0.2) + 1e-6


@pytest.mark.parametrize("seed", SEEDS)
def test_camera_looks_at_the_drawer_from_a_good_place(seed):
    world = draw_world(seed, salt="a")
    X = world.camera.X_base_camera_true
    np.testing.assert_allclose(X[:3, :3].T @ X[:3, :3], np.eye(3), atol=1e-9)
    assert np.linalg.det(X[:3, :3]) == pytest.approx(1.0)
    handle = np.array(
        [world.object.x_front_m - world.object.opening_m, world.object.y_m, world.object.height_m]
    )
    seen = np.linalg.inv(X) @ np.append(handle, 1.0)
    assert 0.6 <= seen[2] <= 0.95
    elevation = np.rad2deg(np.arcsin(-X[2, 2]))
    assert 15 <= elevation <= 45


def test_reported_pose_differs_from_the_true_one_by_the_hand_eye_error():
    camera = draw_world(5, salt="a").camera
    error = np.linalg.inv(camera.X_base_camera_true) @ camera.X_base_camera_reported
    np.testing.assert_allclose(error[:3, 3], camera.hand_eye_m, atol=1e-12)
    angle = np.arccos((np.trace(error[:3, :3]) - 1) / 2)
    assert angle == pytest.approx(np.linalg.norm(camera.hand_eye_rad), rel=1e-4)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"salt": None}, "salt"),
        ({"colour": "red"}, "colour"),
        ({"schema_version": 99}, "schema_version 99 is not 1"),
    ],
)
def test_bad_world_file_is_refused_by_name(tmp_path, change, text):
    content = json.loads(draw_world(1).to_json()) | change
    (tmp_path / "w.json").write_text(json.dumps(content))
    with pytest.raises(WorldFileError, match=text):
        load_world(tmp_path / "w.json")


def test_not_a_number_is_refused(tmp_path):
    content = json.loads(draw_world(1).to_json())
    content["object"]["mass_kg"] = float("nan")
    (tmp_path / "w.json").write_text(json.dumps(content))
    with pytest.raises(WorldFileError, match="mass_kg"):
        load_world(tmp_path / "w.json")


@pytest.mark.parametrize(
    ("kind", "part", "change", "text"),
    [
        ("drawer", "object", {"opening_m": 0.9}, r"opening_m 0\.9 is beyond range_m 0\.3"),
        ("drawer", "object", {"mass_kg": 0.0}, "mass_kg: Input should be greater than 0"),
        ("drawer", "object", {"coulomb_N": -3.0}, "coulomb_N: Input should be greater than or equal to 0"),
        ("laptop", "object", {"q_start": 9.0}, r"q_start 9 is beyond q_max"),
        ("laptop", "object", {"damping": -1.0}, "damping: Input should be greater than or equal to 0"),
        ("chest", "object", {"rows": 0}, "rows: Input should be greater than or equal to 1"),
        ("chest", "object", {"row": 9}, "row 9, column 0 is no place of"),
        ("drawers", "object", {"others": [-0.1]}, r"others \(-0\.1,\) are not all from 0 to q_max"),
        ("dial", "object", {"index": 9}, "index 9 is none of"),
        ("faucet", "object", {"spokes": 0}, "spokes: Input should be greater than or equal to 1"),
        (
            "drawer",
            "arm",
            {"link_mass_scale": [0.0] * 7},
            r"link_mass_scale\.0: Input should be greater than 0",
        ),
        (
            "drawer",
            "camera",
            {"position_m": [0.5, 0.0, 0.8], "target_m": [0.5, 0.0, 0.1]},
            "target_m is at, right above or right below position_m",
        ),
    ],
)
def test_what_no_world_can_be_is_refused_by_name(tmp_path, kind, part, change, text):
    content = json.loads(draw_world(1, kind).to_json())
    content[part] |= change
    (tmp_path / "w.json").write_text(json.dumps(content))
    with pytest.raises(WorldFileError, match=text):
        load_world(tmp_path / "w.json")


def test_a_file_of_another_kind_is_no_world(tmp_path):
    (tmp_path / "w.json").write_bytes(b"\x89PNG\r\n\xff\xfe")
    with pytest.raises(WorldFileError, match=r"w\.json: file: Invalid JSON"):
        load_world(tmp_path / "w.json")


def test_missing_world_file_is_named(tmp_path):
    with pytest.raises(WorldFileError, match=r"none\.json"):
        load_world(tmp_path / "none.json")


def test_unknown_kind_lists_the_known_ones():
    with pytest.raises(WorldFileError, match="'toaster'; known are drawer"):
        draw_world(1, "toaster")


def test_world_is_frozen():
    with pytest.raises(ValueError, match="frozen"):
        draw_world(1).seed = 5


def test_schema_can_be_rebuilt_from_json_text():
    world = draw_world(9)
    assert WorldSpec.model_validate_json(world.to_json()) == world
