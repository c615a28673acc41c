"""Garbage in, a named refusal out: every unusable pair of views, through the command line, with its exit code."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from s2r_host.model.cli import build_model
from s2r_host.perception import BadViewError, Cloud, DepthFrame, estimate_joint
from s2r_host.perception import synthetic as scenes
from s2r_host.perception.motion import rotation


@pytest.fixture(scope="module")
def pair():
    return scenes.drawer_pair(np.random.default_rng(4))


def save(path: Path, frame: DepthFrame) -> Path:
    np.savez(path, depth=frame.depth_m, K=frame.K, T_base_camera=frame.X_base_camera)
    return path


def refusal(before: Path, after: Path, out: Path) -> tuple[int, str]:
    """Exit code and reason of ``s2r build-model --json``."""
    result = CliRunner().invoke(
        build_model, ["--before", str(before), "--after", str(after), "--out", str(out), "--json"]
    )
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    reason = json.loads(result.stdout)["reason"] if result.stdout.startswith("{") else result.stderr
    return result.exit_code, reason


def test_a_transposed_matrix_of_intrinsics_is_named(pair, tmp_path):
    before = save(tmp_path / "a.npz", pair.before)
    after = tmp_path / "b.npz"
    np.savez(after, depth=pair.after.depth_m, K=pair.after.K.T, T_base_camera=pair.after.X_base_camera)
    code, text = refusal(before, after, tmp_path)
    assert code == 4
    assert "is it transposed" in text


def raw(path: Path, frame: DepthFrame, depth: np.ndarray) -> Path:
    """A view that no `DepthFrame` would hold."""
    np.savez(path, depth=depth, K=frame.K, T_base_camera=frame.X_base_camera)
    return path


@pytest.mark.parametrize(
    ("name", "spoil", "reason"),
    [
        ("empty", lambda z: np.zeros_like(z), "holds 0 returns"),
        ("all NaN", lambda z: np.full_like(z, np.nan), "holds 0 returns"),
        ("infinite", lambda z: np.full_like(z, np.inf), "holds 0 returns"),
        ("millimetres", lambda z: 1000 * z, "look like millimetres"),
        ("kilometres", lambda z: z / 1000, "not kilometres"),
        ("negative", lambda z: -z, "negative"),
        ("no image", lambda z: z.ravel(), "expected a (height, width) image"),
    ],
)
def test_an_unusable_depth_image_is_refused_by_name(pair, tmp_path, name, spoil, reason):
    before = save(tmp_path / "a.npz", pair.before)
    code, text = refusal(before, raw(tmp_path / "b.npz", pair.before, spoil(pair.before.depth_m)), tmp_path)
    assert code == 4, (name, text)
    assert reason in text
    assert "b.npz" in text


def test_one_frame_given_twice_under_two_names_is_refused(pair, tmp_path):
    code, text = refusal(
        save(tmp_path / "a.npz", pair.before), save(tmp_path / "b.npz", pair.before), tmp_path
    )
    assert code == 4
    assert "both views are identical" in text


def test_a_missing_second_frame_is_a_usage_error(pair, tmp_path):
    code, text = refusal(save(tmp_path / "a.npz", pair.before), tmp_path / "none.npz", tmp_path)
    assert code == 2
    assert "no such file" in text


def test_a_file_that_is_no_view_is_a_usage_error(pair, tmp_path):
    (tmp_path / "b.npz").write_bytes(b"PK not really")
    code, text = refusal(save(tmp_path / "a.npz", pair.before), tmp_path / "b.npz", tmp_path)
    assert code == 2
    assert "not a readable NPZ file" in text


def test_a_camera_that_moved_is_named(pair, tmp_path):
    shift = np.eye(4)
    shift[:3, :3] = rotation(np.array([0.0, 0.0, 1.0]), np.radians(3))
    shift[:3, 3] = [0.02, -0.01, 0.015]
    moved = replace(pair.after, X_base_camera=shift @ pair.after.X_base_camera)
    code, text = refusal(save(tmp_path / "a.npz", pair.before), save(tmp_path / "b.npz", moved), tmp_path)
    assert code == 4
    assert "camera moved" in text


def two_that_moved() -> tuple[DepthFrame, DepthFrame]:
    """Two boxes before a cabinet: one slides towards it by 4 cm, the other one by 12 cm, a little askew."""

    def at(p: tuple[float, float, float], size: tuple[float, float, float]) -> scenes.Box:
        X = np.eye(4)
        X[:3, 3] = p
        return scenes.Box(X, np.array(size))

    stays = [at((0.7, 0.0, -0.015), (1.2, 1.6, 0.03)), at((0.82, 0.0, 0.12), (0.3, 0.4, 0.24))]
    first, second = (0.1, 0.3, 0.12), (0.02, 0.22, 0.2)
    K = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]])
    p_target = np.array([0.68, 0.0, 0.1])
    X = scenes.look_at(p_target + np.array([-0.6, -0.2, 0.45]), p_target)
    rng, frames = np.random.default_rng(6), []
    for p_first, p_second in (
        ((0.62, 0.02, 0.15), (0.6, -0.35, 0.1)),
        ((0.66, 0.02, 0.15), (0.72, -0.38, 0.1)),
    ):
        exact, _ = scenes.render([*stays, at(p_first, first), at(p_second, second)], K, (360, 640), X)
        frames.append(DepthFrame(scenes.stereo_like(exact, rng), K, X))
    return frames[0], frames[1]


def test_two_parts_that_moved_are_named_with_both_motions(tmp_path):
    frames = two_that_moved()
    before, after = save(tmp_path / "a.npz", frames[0]), save(tmp_path / "b.npz", frames[1])
    code, text = refusal(before, after, tmp_path / "both")
    assert code == 4
    found = re.fullmatch(
        r"two parts moved: besides the prismatic part \((0\.1\d*) m\), (\d+) % of the change follows another prismatic"
        r" motion \((0\.0\d*)\); move one part at a time or give --region",
        text,
    )
    assert found is not None, text
    assert float(found[1]) == pytest.approx(np.hypot(0.12, 0.03), abs=0.005)
    assert float(found[3]) == pytest.approx(0.04, abs=0.002)
    inside = (0.4, 1.2, -0.2, 0.4, 0.01, 0.4)
    assert estimate_joint(*frames, region=inside).delta == pytest.approx(0.04, abs=0.002)


def million(pair: scenes.Pair, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Both views as clouds of 10^6 points."""
    clouds = []
    for frame in (pair.before, pair.after):
        p = frame.points_base().reshape(-1, 3)
        p = p[np.isfinite(p).all(axis=1)]
        clouds.append(p[rng.integers(len(p), size=1_000_000)] + rng.normal(0, 2e-4, (1_000_000, 3)))
    return clouds[0], clouds[1]


def test_a_cloud_with_nan_and_a_cloud_in_millimetres_are_refused(pair):
    points, _ = million(pair, np.random.default_rng(0))
    with pytest.raises(BadViewError, match="look like millimetres"):
        Cloud(1000 * points)
    points[7] = np.nan
    with pytest.raises(BadViewError, match="1 points that are not finite"):
        Cloud(points)


def test_a_million_points_are_thinned_before_anything_costly(pair):
    from s2r_host.perception.view import MOST_CLOUD_POINTS, CloudView

    view = CloudView(Cloud(million(pair, np.random.default_rng(0))[0]), np.random.default_rng(0))
    assert len(view.points) == MOST_CLOUD_POINTS


USED_BY = """
import json, resource, subprocess, sys
subprocess.run(sys.argv[2:], check=True)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
with open(sys.argv[1], "w") as file:
    json.dump({"cpu_s": used.ru_utime + used.ru_stime, "peak_kb": used.ru_maxrss}, file)
"""


def test_two_clouds_of_a_million_points_become_a_model_in_bounded_time_and_memory(pair, tmp_path):
    for name, points in zip("ab", million(pair, np.random.default_rng(0)), strict=True):
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
        (tmp_path / f"{name}.ply").write_bytes(header.encode() + points.astype("<f8").tobytes())
    command = [
        "build-model",
        "--before",
        tmp_path / "a.ply",
        "--after",
        tmp_path / "b.ply",
        "--out",
        tmp_path,
        "--json",
    ]
    # The kernel hands a fork the peak of whoever forked it, here a test runner of any size:
    # a small process in between starts the command and tells what its child used.
    between = [sys.executable, "-c", USED_BY, tmp_path / "used.json", sys.executable, "-m", "s2r_protocol"]
    with (tmp_path / "answer.json").open("w") as answer:
        subprocess.run([*between, *command], stdout=answer, check=True)
    used = json.loads((tmp_path / "used.json").read_text())
    model = json.loads((tmp_path / "answer.json").read_text())
    assert model["joint_type"] == "prismatic"
    assert model["delta"] == pytest.approx(pair.motion.delta, abs=0.003)
    assert used["cpu_s"] < 60  # 15 s: 40 000 points of each are used
    assert used["peak_kb"] < 1.5e6  # 0.5 GB, of which the libraries are most
