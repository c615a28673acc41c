"""Points to pixels and back."""

import numpy as np
import pytest

from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import DepthFrame, backproject, project

K = np.array([[400.0, 0.0, 31.5], [0.0, 380.0, 20.5], [0.0, 0.0, 1.0]])
X_BC = np.array([[0.0, 0.6, 0.8, 0.1], [-1.0, 0.0, 0.0, -0.2], [0.0, -0.8, 0.6, 0.4], [0.0, 0.0, 0.0, 1.0]])


def test_a_pixels_point_shows_at_that_pixel():
    depth = np.random.default_rng(2).uniform(0.4, 1.5, (40, 60)).astype(np.float32)
    uv, z = project(backproject(depth, K, X_BC), K, X_BC)
    np.testing.assert_allclose(uv, np.stack(np.meshgrid(np.arange(60), np.arange(40)), axis=-1), atol=1e-9)
    np.testing.assert_allclose(z, depth, rtol=1e-12)


def test_what_is_behind_the_camera_has_no_pixel():
    p = X_BC[:3, 3] + np.array([[0.5], [-0.5], [0.0]]) * X_BC[:3, 2]
    uv, z = project(p, K, X_BC)
    np.testing.assert_allclose(uv[0], K[:2, 2], atol=1e-9)
    assert np.isnan(uv[1:]).all()
    np.testing.assert_allclose(z, [0.5, -0.5, 0.0], atol=1e-12)


def test_a_transposed_pose_is_refused():
    depth = np.full((40, 60), 0.8, np.float32)
    DepthFrame(depth, K, X_BC)
    with pytest.raises(BadViewError, match=r"T_base_camera must end in the row 0 0 0 1(.|\n)*transposed"):
        DepthFrame(depth, K, X_BC.T)


def test_a_pose_in_one_row_is_refused():
    with pytest.raises(BadViewError, match="T_base_camera must be a finite 4x4 matrix"):
        DepthFrame(np.full((40, 60), 0.8, np.float32), K, X_BC.ravel())


def test_a_colour_image_of_another_size_is_refused():
    depth = np.full((40, 60), 0.8, np.float32)
    with pytest.raises(BadViewError, match=r"shape \(80, 120, 3\); expected uint8 with shape \(40, 60, 3\)"):
        DepthFrame(depth, K, X_BC, np.zeros((80, 120, 3), np.uint8))
