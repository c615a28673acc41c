"""What an object stands on: a level plane, or none in view; in a camera's own frame whatever it is seen to stand on."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from s2r_host.model.build import build_model
from s2r_host.model.points import _support, observe
from s2r_host.perception.estimate import JointEstimate, estimate_joint
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.synthetic import Box, Pair, drawer_pair, look_at, pair

Z = np.array([0.0, 0.0, 1.0])
TO_ROBOT = np.diag([-1.0, -1.0, 1.0, 1.0])
TO_ROBOT[0, 3] = 0.9


def drawer_of_a_kitchen_front() -> Pair:
    """A drawer, 6 cm open and opened by 5 more, in a cabinet that fills the picture: nothing level is in view."""

    def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Box:
        X = TO_ROBOT.copy()
        X[:3, 3] = TO_ROBOT[:3, :3] @ np.mean([low, high], axis=0) + TO_ROBOT[:3, 3]
        return Box(X, np.subtract(high, low))

    front = [
        box((-0.4, -0.25, 0.0), (0, 0.25, 0.2)), box((-0.4, -0.25, 0.4), (0, 0.25, 0.6)),
        box((-0.4, -0.25, 0.2), (0, -0.15, 0.4)), box((-0.4, 0.15, 0.2), (0, 0.25, 0.4)),
    ]  # fmt: skip
    drawer = [
        box((0.06, -0.16, 0.19), (0.078, 0.16, 0.41)), box((0.11, -0.06, 0.30), (0.122, 0.06, 0.312)),
        box((0.078, -0.06, 0.30), (0.11, -0.05, 0.312)), box((0.078, 0.05, 0.30), (0.11, 0.06, 0.312)),
        box((-0.2, -0.14, 0.21), (0.06, 0.14, 0.25)),
    ]  # fmt: skip
    K = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]])
    camera = look_at(np.array([0.1, 0.1, 0.5]), np.array([0.9, 0, 0.3]))
    motion = JointMotion("prismatic", TO_ROBOT[:3, 3].copy(), TO_ROBOT[:3, 0], 0.05)
    return pair(front, drawer, motion, K, (360, 640), camera, np.random.default_rng(0))


def told(shown: Pair) -> JointEstimate:
    return estimate_joint(shown.before, shown.after)


def in_cameras_frame(shown: Pair) -> JointEstimate:
    before, after = (replace(view, X_base_camera=np.eye(4)) for view in (shown.before, shown.after))
    return estimate_joint(before, after, up=None)


def test_the_front_around_a_drawer_is_no_table(tmp_path):
    estimate = told(drawer_of_a_kitchen_front())
    np.testing.assert_array_equal(observe(estimate, np.random.default_rng(0)).up, Z)
    model = build_model(estimate, tmp_path)
    assert {"front", "handle_bar", "cabinet"} <= {piece.name for piece in model.pieces}
    assert not model.warnings


@pytest.mark.parametrize(("z_m", "height_m"), [(0.65, 0.4), (0.35, 0.35)])
def test_what_hangs_over_the_part_is_no_support(z_m, height_m):
    """The underside of a shelf has all of the part on one side, as the top of one has that is below it."""
    rng = np.random.default_rng(0)
    shelf, part = (
        rng.uniform((0.3, -0.3, z), (0.9, 0.3, z + d), (3000, 3)) for z, d in ((z_m, 0), (0.4, 0.2))
    )
    p, normal = _support(shelf, np.tile(Z, (3000, 1)), part, np.array([-0.1, 0.0, 0.5]), Z, rng)
    assert normal == pytest.approx(Z)
    assert p[2] == pytest.approx(height_m, abs=0.001)


@pytest.mark.parametrize(("up", "told"), [(Z, Z), (None, np.array([0.0, -1.0, 0.0]))])
def test_without_any_plane_it_stands_at_the_lowest_point_of_what_is_level_or_of_the_picture(up, told):
    rng = np.random.default_rng(0)
    rest, part = rng.uniform(-0.2, 0.2, (50, 3)), rng.uniform(-0.1, 0.1, (50, 3))
    p, normal = _support(rest, np.tile(Z, (50, 1)), part, np.zeros(3), up, rng)
    np.testing.assert_array_equal(normal, told)
    assert p @ told == (rest @ told).min()


@pytest.fixture(scope="module")
def drawer() -> Pair:
    return drawer_pair(np.random.default_rng(4))


def test_in_a_cameras_frame_gravity_goes_to_what_the_object_stands_on(drawer, tmp_path):
    model = build_model(in_cameras_frame(drawer), tmp_path)
    gravity = mujoco.MjModel.from_xml_path(str(model.mjcf_path)).opt.gravity
    down = -drawer.before.X_base_camera[:3, :3].T @ Z
    assert np.linalg.norm(gravity) == pytest.approx(9.81)
    assert gravity @ down / 9.81 > np.cos(np.radians(1.0))


def test_in_the_base_frame_gravity_is_along_z(drawer, tmp_path):
    model = build_model(told(drawer), tmp_path)
    assert mujoco.MjModel.from_xml_path(str(model.mjcf_path)).opt.gravity == pytest.approx(-9.81 * Z)
