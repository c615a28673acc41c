"""Files become views, and garbage is refused by name."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from s2r_host.perception import BadViewError, Cloud, DepthFrame, InputError, load_frame
from s2r_host.perception.change import Change, compare, with_shadows
from s2r_host.perception.loading import load_camera, virtual_pinhole
from s2r_host.perception.view import DepthView
from s2r_protocol.exits import ExitCode

K = np.array([[200.0, 0, 80], [0, 200.0, 60], [0, 0, 1]])


def plate(z_m: float = 0.8) -> np.ndarray:
    return np.full((120, 160), z_m, dtype=np.float32)


def write_npz(path, **changes):
    content = {"depth": plate(), "K": K, "T_base_camera": np.eye(4)} | changes
    np.savez(path, **{k: v for k, v in content.items() if v is not None})
    return path


def write_ply(path, points, colour=None):
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    rows = [" ".join(f"{v:.6f}" for v in p) for p in points]
    if colour is not None:
        lines += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
        rows = [f"{row} {' '.join(map(str, rgb))}" for row, rgb in zip(rows, colour, strict=True)]
    lines += ["end_header", *rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_camera(path, **changes):
    intrinsics = {"fx": 200, "fy": 200, "cx": 80, "cy": 60, "width": 160, "height": 120}
    path.write_text(json.dumps({"intrinsics": intrinsics, "base_T_camera": np.eye(4).tolist()} | changes))
    return path


def plane_points(n: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-0.3, 0.3, n), rng.uniform(-0.2, 0.2, n), np.full(n, 0.8)])


def test_npz_gives_depth_and_camera(tmp_path):
    frame = load_frame(write_npz(tmp_path / "a.npz"))
    assert isinstance(frame, DepthFrame)
    np.testing.assert_allclose(frame.points_base()[60, 80], [0, 0, 0.8], atol=1e-6)


def test_camera_frame_ignores_the_pose(tmp_path):
    pose = np.eye(4)
    pose[:3, 3] = 1.0
    frame = load_frame(write_npz(tmp_path / "a.npz", T_base_camera=pose), frame="camera")
    np.testing.assert_array_equal(frame.X_base_camera, np.eye(4))


def test_png_millimetres_become_metres(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), (plate() * 1000).astype(np.uint16))
    frame = load_frame(tmp_path / "a.png", camera=write_camera(tmp_path / "camera.json"))
    assert isinstance(frame, DepthFrame)
    assert frame.depth_m.max() == pytest.approx(0.8)


def test_ply_in_the_base_frame_is_a_cloud(tmp_path):
    cloud = load_frame(write_ply(tmp_path / "a.ply", plane_points()))
    assert isinstance(cloud, Cloud)
    assert len(cloud.points) == 4000


def test_ply_in_the_camera_frame_gets_its_image_back(tmp_path):
    frame = load_frame(write_ply(tmp_path / "a.ply", plane_points()), frame="camera")
    assert isinstance(frame, DepthFrame)
    assert (frame.depth_m > 0).mean() > 0.4
    assert np.median(frame.depth_m[frame.depth_m > 0]) == pytest.approx(0.8, abs=1e-3)


def test_a_hole_in_a_coloured_cloud_is_no_motion(tmp_path):
    """A hole in an image with colour, over what stood near before, moved if its colour changed; a cloud has none."""
    depth = plate()
    depth[40:80, 60:100] = 0.6
    looks = []
    for name, holed in (("a", False), ("b", True)):
        shown = depth.copy()
        if holed:
            shown[48:72, 76:84] = 0.0
        points = DepthFrame(shown, K, np.eye(4)).points_base()[shown > 0]
        colour = np.where(points[:, 2:] < 0.7, [200, 60, 60], [120, 140, 90])
        path = write_ply(tmp_path / f"{name}.ply", points, colour)
        looks.append(load_frame(path, camera=write_camera(tmp_path / "camera.json")))
    before, after = (DepthView(look) for look in looks)
    changes = with_shadows(before, after, compare(before, after))
    assert not (changes.before == Change.MOVED).any()
    assert not (changes.after == Change.MOVED).any()


def test_a_million_points_are_fine(tmp_path):
    rng = np.random.default_rng(2)
    points = rng.uniform([-0.5, -0.4, 0.7], [0.5, 0.4, 0.9], (1_000_000, 3))
    K_virtual, shape = virtual_pinhole(points)
    assert max(shape) <= 1400
    assert K_virtual[0, 0] <= 900


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"depth": plate(0.0)}, "holds 0 returns"),
        ({"depth": np.full((120, 160), np.nan, np.float32)}, "holds 0 returns"),
        (
            {"colour": np.zeros((60, 80, 3), np.uint8)},
            r"colour is uint8 with shape \(60, 80, 3\); expected uint8",
        ),
        ({"colour": np.zeros((120, 160, 3))}, r"colour is float64 .* convert it, or leave it out"),
        ({"depth": plate(800.0)}, "look like millimetres"),
        ({"depth": plate(-0.5)}, "negative"),
        ({"K": np.diag([0.0, 0.0, 1.0])}, "focal"),
        (
            {"K": np.diag([2.0, 2.0, 1.0]) @ K},
            r"does not belong to a 160x120 image: .* middle of 320x240\..* resolution",
        ),
        ({"K": np.diag([0.5, 0.5, 1.0]) @ K}, r"middle of 80x60\."),
        ({"K": np.diag([4 / 3, 4 / 3, 1.0]) @ K}, r"middle of 213x160\."),
        ({"K": np.diag([4 / 3, 1.0, 1.0]) @ K}, r"middle of 213x120\."),
        ({"K": K + np.array([[0, 40.0, 0], [0, 0, 0], [0, 0, 0]])}, "skew of 40 px"),
        ({"T_base_camera": np.diag([2.0, 1, 1, 1])}, "not a rotation"),
        ({"depth": np.ones((3, 120, 160), np.float32)}, "shape"),
    ],
)
def test_garbage_in_an_npz_is_named(tmp_path, changes, words):
    with pytest.raises(BadViewError, match=words) as caught:
        load_frame(write_npz(tmp_path / "bad.npz", **changes))
    assert "bad.npz" in str(caught.value)
    assert caught.value.exit_code is ExitCode.REFUSED


def test_missing_fields_are_listed(tmp_path):
    with pytest.raises(InputError, match=r"missing K, T_base_camera"):
        load_frame(write_npz(tmp_path / "a.npz", K=None, T_base_camera=None))


def test_unknown_kind_lists_the_known_ones(tmp_path):
    (tmp_path / "a.stl").write_text("x")
    with pytest.raises(InputError, match=r"\.ply, \.npz and \.png"):
        load_frame(tmp_path / "a.stl")


def test_broken_npz_is_refused(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match="not a readable NPZ"):
        load_frame(tmp_path / "a.npz")


def test_a_file_that_is_no_ply_is_refused_with_what_it_begins_with(tmp_path):
    (tmp_path / "a.ply").write_bytes(b"solid drawer")
    with pytest.raises(InputError, match=r"not a PLY file; it begins with b'soli'"):
        load_frame(tmp_path / "a.ply")


@pytest.mark.parametrize("lost", [1, 30_000])
def test_a_ply_that_is_cut_off_is_refused_with_what_is_there(tmp_path, lost):
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 4000\n"
    head += b"".join(b"property float %c\n" % axis for axis in b"xyz") + b"end_header\n"
    whole = head + plane_points().astype("<f4").tobytes()
    (tmp_path / "a.ply").write_bytes(whole)
    assert len(load_frame(tmp_path / "a.ply").points) == 4000
    (tmp_path / "a.ply").write_bytes(whole[:-lost])
    with pytest.raises(InputError, match=rf"{4000 - -(-lost // 12)} of the 4000 points .* cut off"):
        load_frame(tmp_path / "a.ply")


def test_an_ascii_ply_that_is_cut_off_is_refused(tmp_path):
    path = write_ply(tmp_path / "a.ply", plane_points())
    path.write_text("\n".join(path.read_text().splitlines()[:2000]))
    with pytest.raises(InputError, match=r"of the 4000 points that its header tells of are there"):
        load_frame(path)


def test_a_ply_whose_header_does_not_end_or_has_no_coordinates_is_refused(tmp_path):
    (tmp_path / "a.ply").write_text("ply\nformat ascii 1.0\nelement vert")
    with pytest.raises(InputError, match="no 'end_header'"):
        load_frame(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float a\nend_header\n1\n"
    )
    with pytest.raises(InputError, match="no x, y, z; a depth view needs"):
        load_frame(tmp_path / "a.ply")


@pytest.mark.parametrize(("key", "value", "words"), [("fx", -1.0, "fx -1"), ("cy", float("nan"), "cy nan")])
def test_a_camera_file_with_impossible_intrinsics_is_named(tmp_path, key, value, words):
    camera = write_camera(tmp_path / "camera.json")
    content = json.loads(camera.read_text())
    content["intrinsics"][key] = value
    camera.write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"camera.json: .*{words}"):
        load_camera(camera)


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (np.full((4, 4), np.nan), "must be a finite 4x4 matrix"),
        (np.eye(3), "must be a finite 4x4 matrix"),
        (np.zeros((4, 4)), "must end in the row 0 0 0 1"),
        (np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.5, 0, 0, 1]]), "transposed"),
        (np.diag([1000.0, 1000.0, 1000.0, 1.0]), "not a rotation"),
    ],
)
def test_a_camera_file_with_a_pose_that_is_none_is_named(tmp_path, pose, words):
    camera = write_camera(tmp_path / "camera.json", base_T_camera=pose.tolist())
    with pytest.raises(InputError, match=rf"camera\.json: .*base_T_camera (?s:.*){words}"):
        load_frame(write_ply(tmp_path / "a.ply", plane_points()), camera=camera)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("width", float("inf"), "missing or unusable field"),
        ("width", -160, "an image of -160x120"),
        ("height", 0, "an image of 160x0"),
        ("height", 10**9, "an image of 160x1000000000; expected 1 to 20000 pixels"),
        ("width", 80, "does not belong to a 80x120 image: it would be the middle of 160x120"),
    ],
)
def test_a_camera_file_of_no_image_or_of_another_one_is_named(tmp_path, key, value, words):
    camera = write_camera(tmp_path / "camera.json")
    content = json.loads(camera.read_text())
    content["intrinsics"][key] = value
    camera.write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"camera\.json: .*{words}"):
        load_camera(camera)


def test_a_camera_beside_an_npz_that_has_its_own_is_refused(tmp_path):
    view, camera = write_npz(tmp_path / "a.npz"), write_camera(tmp_path / "camera.json")
    with pytest.raises(InputError, match=r"has its own K and T_base_camera: leave --camera out"):
        load_frame(view, camera=camera)
    with pytest.raises(InputError, match=r"has its own K, and --frame camera asks for no pose"):
        load_frame(view, "camera", camera)


def test_a_camera_gives_an_npz_the_pose_that_it_lacks(tmp_path):
    pose = np.eye(4)
    pose[:3, 3] = 1.0
    view = write_npz(tmp_path / "a.npz", T_base_camera=None)
    camera = write_camera(tmp_path / "camera.json", base_T_camera=pose.tolist())
    np.testing.assert_array_equal(load_frame(view, camera=camera).X_base_camera, pose)
    other = write_npz(tmp_path / "b.npz", T_base_camera=None, K=np.diag([1.1, 1.1, 1.0]) @ K)
    with pytest.raises(InputError, match=r"a K and a size of its own, and the camera file has others"):
        load_frame(other, camera=camera)


def test_infinite_depth_is_no_return_with_nan_beside_it_and_without(tmp_path):
    for nothing in (np.inf, -np.inf, np.nan):
        depth = plate()
        depth[:20] = nothing
        frame = load_frame(write_npz(tmp_path / "a.npz", depth=depth))
        assert (frame.depth_m > 0).sum() == 100 * 160


def test_a_cloud_beside_the_optical_axis_has_a_camera_of_its_own(tmp_path):
    points = plane_points() + np.array([1.0, 0.0, 0.0])
    frame = load_frame(write_ply(tmp_path / "a.ply", points), frame="camera")
    seen = frame.points_base()[frame.depth_m > 0]
    np.testing.assert_allclose(np.median(seen, axis=0), np.median(points, axis=0), atol=0.01)


def test_absent_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_frame(tmp_path / "none.ply")


def test_png_needs_a_camera(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), (plate() * 1000).astype(np.uint16))
    with pytest.raises(InputError, match="--camera"):
        load_frame(tmp_path / "a.png")


def test_eight_bit_png_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((120, 160), 200, np.uint8))
    with pytest.raises(InputError, match="16-bit"):
        load_frame(tmp_path / "a.png", camera=write_camera(tmp_path / "camera.json"))


def test_png_of_another_size_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((60, 80), 800, np.uint16))
    with pytest.raises(InputError, match="80x60 but the camera file says 160x120"):
        load_frame(tmp_path / "a.png", camera=write_camera(tmp_path / "camera.json"))


def test_camera_file_without_a_focal_length_is_refused(tmp_path):
    camera = write_camera(tmp_path / "camera.json", intrinsics={"fx": 200})
    cv2.imwrite(str(tmp_path / "a.png"), np.full((120, 160), 800, np.uint16))
    with pytest.raises(InputError, match="fy"):
        load_frame(tmp_path / "a.png", camera=camera)


def test_ply_in_millimetres_is_named(tmp_path):
    with pytest.raises(BadViewError, match="millimetres"):
        load_frame(write_ply(tmp_path / "a.ply", plane_points() * 1000))


def test_empty_ply_is_refused(tmp_path):
    with pytest.raises(BadViewError, match="no points"):
        load_frame(write_ply(tmp_path / "a.ply", np.zeros((0, 3))))


def test_ply_of_nan_is_refused(tmp_path):
    with pytest.raises(BadViewError, match="0 finite points"):
        load_frame(write_ply(tmp_path / "a.ply", np.full((500, 3), np.nan)))


def test_cloud_behind_the_camera_is_refused(tmp_path):
    with pytest.raises(BadViewError, match="behind the camera"):
        load_frame(write_ply(tmp_path / "a.ply", plane_points() * [1, 1, -1]), frame="camera")
