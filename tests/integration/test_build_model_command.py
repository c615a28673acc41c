"""``s2r build-model`` from files to answer, on made-up views and on real laptop views where they are at hand."""

from __future__ import annotations

import json
import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from s2r_host.model.cli import build_model
from s2r_host.perception import synthetic as scenes

SHARED = Path(os.environ.get("S2R_SHARED_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
CLIP = SHARED / "screwmimic" / "close_laptop_1"


def run(*arguments: object):
    return CliRunner().invoke(build_model, [str(a) for a in arguments])


def save(path: Path, frame) -> Path:
    np.savez(path, depth=frame.depth_m, K=frame.K, T_base_camera=frame.X_base_camera)
    return path


@pytest.fixture(scope="module")
def drawer_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    pair = scenes.drawer_pair(np.random.default_rng(4))
    return pair, save(folder / "a.npz", pair.before), save(folder / "b.npz", pair.after)


def test_json_answer_has_every_promised_field_and_loadable_models(drawer_files, tmp_path):
    pair, before, after = drawer_files
    result = run("--before", before, "--after", after, "--out", tmp_path, "--json")
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["joint_type"] == "prismatic"
    assert answer["unit"] == "m"
    assert answer["frame"] == "base"
    assert answer["delta"] == pytest.approx(pair.motion.delta, abs=0.001)
    assert np.dot(answer["axis_direction"], pair.motion.direction) > 0.999
    assert set(answer["intervals90"]) == {"axis_angle_rad", "axis_offset_m", "delta"}
    assert answer["residual_m"] < 0.003
    assert isinstance(answer["warnings"], list)
    assert {part["name"] for part in answer["parts"]} == {"object_base", "object_part"}
    mujoco.MjModel.from_xml_path(answer["model_mjcf"])
    assert Path(answer["model_urdf"]).is_file()
    for picture in ("view_before.png", "view_after.png", "cloud.png", "model.png"):
        assert (tmp_path / picture).stat().st_size > 5000


def test_no_motion_abstains_with_exit_4(drawer_files, tmp_path):
    pair, before, _ = drawer_files
    noise = 0.001 * np.random.default_rng(0).standard_normal(pair.before.depth_m.shape)
    depth = np.where(pair.before.depth_m > 0, pair.before.depth_m + noise, 0).astype(np.float32)
    np.savez(tmp_path / "c.npz", depth=depth, K=pair.before.K, T_base_camera=pair.before.X_base_camera)
    result = run("--before", before, "--after", tmp_path / "c.npz", "--out", tmp_path, "--json")
    assert result.exit_code == 4
    answer = json.loads(result.stdout)
    assert answer["abstain"] is True
    assert "no motion seen" in answer["reason"]


def test_an_empty_view_is_refused_with_a_reason(drawer_files, tmp_path):
    pair, before, _ = drawer_files
    depth = np.zeros_like(pair.before.depth_m)
    np.savez(tmp_path / "e.npz", depth=depth, K=pair.before.K, T_base_camera=pair.before.X_base_camera)
    result = run("--before", before, "--after", tmp_path / "e.npz", "--out", tmp_path, "--json")
    assert result.exit_code == 4
    assert "holds 0 returns" in json.loads(result.stdout)["reason"]


def test_one_file_twice_is_a_usage_error(drawer_files, tmp_path):
    _, before, _ = drawer_files
    result = run("--before", before, "--after", before, "--out", tmp_path)
    assert result.exit_code == 2
    assert "same file" in result.stderr


def test_an_end_given_again_as_a_view_from_between_is_a_usage_error(drawer_files, tmp_path):
    _, before, after = drawer_files
    result = run("--before", before, "--after", after, "--between", after, "--out", tmp_path)
    assert result.exit_code == 2
    assert "is the view of --after" in result.stderr


def test_views_from_between_go_with_one_part_only(drawer_files, tmp_path):
    _, before, after = drawer_files
    other = tmp_path / "other.npz"
    result = run("--before", before, "--after", after, "--between", other, "--several", "--out", tmp_path)
    assert result.exit_code == 2
    assert "--between refines the joint of one part" in result.stderr


def test_a_cloud_without_a_camera_from_between_is_a_usage_error(drawer_files, tmp_path):
    pair, before, after = drawer_files
    p = pair.after.points_base().reshape(-1, 3)
    lines = [" ".join(f"{value:.4f}" for value in row) for row in p[np.isfinite(p).all(axis=1)][::20]]
    head = ["ply", "format ascii 1.0", f"element vertex {len(lines)}"]
    head += [f"property float {name}" for name in "xyz"] + ["end_header"]
    cloud = tmp_path / "cloud.ply"
    cloud.write_text("\n".join(head + lines) + "\n")
    result = run("--before", before, "--after", after, "--between", cloud, "--out", tmp_path)
    assert result.exit_code == 2
    assert "--between needs depth images" in result.stderr


def test_a_drawer_is_told_as_well_with_a_view_from_between(drawer_files, tmp_path):
    pair, before, after = drawer_files
    half = scenes.drawer_pair(np.random.default_rng(4), 0.5 * pair.motion.delta)
    between = save(tmp_path / "half.npz", half.after)
    options = ("--before", before, "--after", after, "--between", between, "--out", tmp_path, "--json")
    result = run(*options)
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["delta"] == pytest.approx(pair.motion.delta, abs=0.001)
    assert np.dot(answer["axis_direction"], pair.motion.direction) > 0.9995
    assert not any("between" in text for text in answer["warnings"])


def test_a_bad_region_is_a_usage_error(drawer_files, tmp_path):
    _, before, after = drawer_files
    result = run("--before", before, "--after", after, "--out", tmp_path, "--region", "1,0,0,1,0,1")
    assert result.exit_code == 2
    assert "six numbers" in result.stderr


def real_answer(first: int, second: int, out: Path) -> tuple[dict, dict]:
    if not CLIP.is_dir():
        pytest.skip(f"real laptop views not found at {CLIP}; set S2R_SHARED_DATA")
    camera = CLIP / "camera.json"
    views = [CLIP / "depth_mm" / f"{k:04d}.png" for k in (first, second)]
    result = run("--before", views[0], "--after", views[1], "--camera", camera, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout), json.loads((CLIP / "reference.json").read_text())


@pytest.mark.parametrize(("first", "second"), [(3, 11), (8, 13)])
def test_a_real_laptop_lid_is_found(first, second, tmp_path):
    """Pseudo truth of the clip is good to 0.7 degrees and 8 mm."""
    answer, reference = real_answer(first, second, tmp_path)
    angles = reference["lid_plane_normal_angle_deg"]
    true_deg = angles[str(second)] - angles[str(first)]
    axis = np.sign(true_deg) * np.array(reference["axis_direction"])
    assert answer["joint_type"] == "revolute"
    error = np.degrees(np.arccos(np.clip(axis @ answer["axis_direction"] / np.linalg.norm(axis), -1, 1)))
    assert error < 3.5
    assert abs(np.degrees(answer["delta"]) - abs(true_deg)) < 2.0


def test_still_real_views_abstain(tmp_path):
    if not CLIP.is_dir():
        pytest.skip(f"real laptop views not found at {CLIP}; set S2R_SHARED_DATA")
    views = [CLIP / "depth_mm" / f"{k:04d}.png" for k in (1, 4)]
    result = run(
        "--before",
        views[0],
        "--after",
        views[1],
        "--camera",
        CLIP / "camera.json",
        "--out",
        tmp_path,
        "--json",
    )
    assert result.exit_code == 4
    assert "no motion" in json.loads(result.stdout)["reason"]
