"""Convex decomposition in a child process."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import trimesh

from s2r_host.model.decompose import decompose, voxel_surface
from s2r_host.model.pieces import box, hull


def l_shape() -> np.ndarray:
    rng = np.random.default_rng(0)
    a = rng.uniform([0, 0, 0], [0.10, 0.02, 0.02], (3000, 3))
    b = rng.uniform([0, 0, 0], [0.02, 0.10, 0.02], (3000, 3))
    return np.concatenate([a, b])


def test_the_surface_of_voxels_is_closed_and_has_their_volume():
    points = np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [1.5, 1.5, 0.5]])
    vertices, faces = voxel_surface(points, 1.0)
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight
    assert mesh.volume == 3.0


def test_an_l_becomes_more_than_one_convex_piece():
    hulls, warning = decompose(l_shape(), 0.01, cpu_limit_s=60)
    assert warning is None
    assert len(hulls) >= 2
    volume = sum(hull(f"h{i}", "part", vertices).volume_m3 for i, vertices in enumerate(hulls))
    single = hull("one", "part", l_shape()).volume_m3
    assert volume < 0.75 * single


def test_out_of_time_gives_one_hull_and_says_so():
    hulls, warning = decompose(l_shape(), 0.01, cpu_limit_s=0.01)
    assert len(hulls) == 1
    assert warning is not None
    assert "more than 0.01 s of processor time" in warning


def test_building_a_model_never_imports_coacd_here():
    """Imported before Open3D it breaks Open3D; it belongs in the child process only."""
    code = "import sys, s2r_host.model, s2r_host.model.decompose; assert 'coacd' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_pieces_know_their_volume_and_outward_faces():
    cube = box("c", "part", np.eye(4), np.zeros(3), np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(cube.volume_m3, 0.006)
    np.testing.assert_allclose(trimesh.Trimesh(cube.vertices, cube.faces()).volume, 0.006)
