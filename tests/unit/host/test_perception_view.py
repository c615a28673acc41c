"""Normals, noise and the answers of a view."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_host.perception.change import Change, compare
from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import Cloud, DepthFrame
from s2r_host.perception.view import CloudView, DepthView, Seen, fit_planes, noise_sigma

K = np.array([[300.0, 0, 100], [0, 300.0, 75], [0, 0, 1]])
SHAPE = (150, 200)


def slope(a: float, b: float, z0: float = 0.8) -> np.ndarray:
    """Exact depth of the plane z = z0 + a x + b y."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    return z0 / (1 - a * x - b * y)


def view(depth: np.ndarray) -> DepthView:
    return DepthView(DepthFrame(depth.astype(np.float32), K, np.eye(4)))


def test_normals_of_an_exact_plane_are_exact():
    _, normal, good = fit_planes(slope(0.4, -0.7), K)
    expected = np.array([0.4, -0.7, -1.0]) / np.linalg.norm([0.4, -0.7, -1.0])
    assert good[10:-10, 10:-10].all()
    assert np.abs(normal[good] - expected).max() < 1e-6


def test_plane_fit_reduces_noise():
    rng = np.random.default_rng(0)
    exact = slope(0.2, 0.3)
    noisy = exact + noise_sigma(exact) * rng.standard_normal(SHAPE)
    smooth, normal, good = fit_planes(noisy, K)
    expected = np.array([0.2, 0.3, -1.0]) / np.linalg.norm([0.2, 0.3, -1.0])
    angle = np.degrees(np.arccos(np.clip(normal[good] @ expected, -1, 1)))
    assert np.median(angle) < 3.0
    assert np.std((smooth - exact)[good]) < 0.4 * np.std(noisy - exact)


def test_noise_grows_with_the_square_of_depth():
    assert noise_sigma(np.array(2.0)) - noise_sigma(np.array(0.0)) == pytest.approx(
        4 * (noise_sigma(np.array(1.0)) - noise_sigma(np.array(0.0)))
    )


def test_points_in_front_behind_and_on_the_surface_are_told_apart():
    wall = view(slope(0, 0))
    p = np.array([[0, 0, 0.6], [0, 0, 0.8], [0, 0, 1.0], [2.0, 0, 0.8], [0, 0, -0.5]])
    assert wall.look(p, 0.001).seen.tolist() == [Seen.FREE, Seen.SURFACE, Seen.HIDDEN, Seen.OUT, Seen.OUT]


def test_a_hole_is_no_evidence():
    depth = slope(0, 0)
    depth[60:90, 80:120] = 0
    assert view(depth).look(np.array([[0, 0, 0.6]]), 0.001).seen.tolist() == [Seen.NO_RETURN]


def test_a_plate_that_left_is_moved_and_what_it_uncovers_is_unknown():
    before, after = slope(0, 0), slope(0, 0)
    before[50:100, 60:140] = 0.7
    changes = compare(view(before), view(after))
    label_before = view(before).image(changes.before)
    label_after = view(after).image(changes.after)
    assert label_before[75, 100] == Change.MOVED
    assert label_after[75, 100] == Change.UNKNOWN
    assert label_before[20, 20] == Change.STATIC


def test_specks_are_not_motion():
    before, after = slope(0, 0), slope(0, 0)
    before[50:53, 60:63] = 0.7
    changes = compare(view(before), view(after))
    assert (changes.before == Change.MOVED).sum() == 0


def test_large_images_are_thinned_and_masks_come_back_full_size():
    depth = np.full((720, 1280), 0.8, dtype=np.float32)
    K_large = np.array([[920.0, 0, 640], [0, 920.0, 360], [0, 0, 1]])
    seen = DepthView(DepthFrame(depth, K_large, np.eye(4)))
    assert seen.shape == (360, 640)
    assert seen.image(np.ones(len(seen.points), dtype=bool)).shape == (720, 1280)


def test_ignored_pixels_are_forgotten():
    mask = np.zeros(SHAPE, dtype=bool)
    mask[:, :100] = True
    seen = DepthView(DepthFrame(slope(0, 0).astype(np.float32), K, np.eye(4)), ignore=mask)
    assert len(seen.points) == SHAPE[0] * 100


def test_a_bare_cloud_never_claims_free_space():
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-0.2, 0.2, (5000, 2)), np.zeros(5000)])
    seen = CloudView(Cloud(points), rng)
    answer = seen.look(np.array([[0, 0, 0.0], [0, 0, 0.03], [0, 0, 0.5]]), 0.001).seen
    assert answer[0] == Seen.SURFACE
    assert Seen.FREE not in answer


def test_a_mask_of_zeros_and_ones_forgets_its_pixels():
    frame = DepthFrame(slope(0.1, 0.2).astype(np.float32), K, np.eye(4))
    mask = np.zeros(SHAPE, np.uint8)
    mask[40:60, 70:100] = 1
    forgotten = DepthView(frame, mask)  # type: ignore[arg-type]
    assert np.array_equal(forgotten.depth == 0.0, mask > 0)


def test_a_mask_of_another_size_is_refused():
    frame = DepthFrame(slope(0.1, 0.2).astype(np.float32), K, np.eye(4))
    with pytest.raises(BadViewError, match=r"ignore has shape \(10, 10\), the frame's depth \(150, 200\)"):
        DepthView(frame, np.zeros((10, 10), bool))


def test_a_pinhole_matrix_of_whole_numbers_is_one():
    depth = slope(0.1, 0.2).astype(np.float32)
    whole = DepthView(DepthFrame(depth, K.astype(int), np.eye(4)))
    assert np.array_equal(whole.points, DepthView(DepthFrame(depth, K, np.eye(4))).points)
