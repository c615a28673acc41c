"""The depth camera: what it sees, how noisy it is, how it travels."""

import mujoco
import numpy as np
import pytest

from s2r_sim.camera.camera import DepthCamera
from s2r_sim.camera.frame import DEPTH_UNIT_M, to_message
from s2r_sim.camera.intrinsics import StereoRig
from s2r_sim.camera.matching import Matching, disparity
from s2r_sim.physics import Physics
from s2r_sim.world import CameraTruth


@pytest.fixture(scope="module")
def physics(arm, world):
    return Physics(arm, world)


@pytest.fixture(scope="module")
def camera(physics, world):
    return DepthCamera(physics.model, world.camera)


@pytest.fixture(scope="module")
def shot(camera, physics):
    """One view, the exact depth and the geom per pixel."""
    qpos = physics.data.qpos.copy()
    view, exact = camera.capture(qpos), camera.exact_depth(qpos)
    hits = camera._cast(np.zeros(3), camera._rays_world)
    return view, exact, hits.geom.reshape(exact.shape)


def pixels(shot, physics, name):
    return shot[2] == physics.model.geom(name).id


def errors(shot, mask):
    view, exact, _ = shot
    valid = mask & (view.depth_m > 0)
    return (view.depth_m - exact)[valid], valid.sum() / mask.sum()


def test_front_is_measured_to_millimetres(shot, physics):
    mask = pixels(shot, physics, "part_front")
    error, share = errors(shot, mask)
    core = error[np.abs(error) < 0.01]
    assert share > 0.85
    assert abs(np.median(error)) < 2e-3  # calibration leaves a smooth bias
    assert 0.5e-3 < np.sqrt(np.mean(core**2)) < 3e-3


def test_plane_noise_at_80_cm_is_that_of_a_d415(shot, physics):
    _, exact, _ = shot
    error, share = errors(shot, pixels(shot, physics, "table") & (np.abs(exact - 0.8) < 0.05))
    assert share > 0.9
    assert 1e-3 < np.sqrt(np.mean(error[np.abs(error) < 0.01] ** 2)) < 3e-3


def test_a_plane_is_seen_from_the_least_distance_of_a_d415_on():
    def seen(distance_m):
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(pos=[distance_m + 0.005, 0, 0])
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.005, 1, 1], rgba=[0.8, 0.8, 0.8, 1])
        zero = (0.0, 0.0, 0.0)
        truth = CameraTruth(
            position_m=zero, target_m=(1, 0, 0), roll_rad=0, hand_eye_m=zero, hand_eye_rad=zero, seed=0
        )
        middle = DepthCamera(spec.compile(), truth).capture(np.zeros(0)).depth_m[90:390, 224:624]
        return np.mean(np.abs(middle - distance_m) < 0.02 * distance_m), np.mean(middle > 0)

    nearest = StereoRig().f_px * StereoRig().baseline_m / 126
    assert seen(1.02 * nearest)[0] > 0.99
    assert seen(0.96 * nearest)[1] < 0.01  # nothing, and nothing wrong either


def test_handle_stands_out_from_the_front(shot, physics):
    error, share = errors(shot, pixels(shot, physics, "part_handle_bar"))
    assert share > 0.6
    assert np.median(np.abs(error)) < 4e-3
    assert np.mean(np.abs(error) < 0.01) > 0.8


def test_depth_has_holes_where_the_other_imager_or_the_light_cannot_look(shot):
    view, exact, _ = shot
    near = (exact > 0) & (exact < 1.3)
    holes = 1 - np.mean(view.depth_m[near] > 0)
    assert 0.02 < holes < 0.3


def test_same_seed_sees_the_same_picture(physics, world):
    qpos = physics.data.qpos.copy()
    views = [DepthCamera(physics.model, world.camera).capture(qpos) for _ in range(2)]
    np.testing.assert_array_equal(views[0].depth_m, views[1].depth_m)


def test_two_pictures_of_one_camera_differ_by_noise_only(camera, physics):
    qpos = physics.data.qpos.copy()
    a, b = camera.capture(qpos).depth_m, camera.capture(qpos).depth_m
    both = (a > 0) & (b > 0) & (a < 1.0)
    assert not np.array_equal(a, b)
    assert np.median(np.abs(a - b)[both]) < 2e-3


def test_moved_drawer_is_seen_moved(camera, physics, world):
    qpos = physics.data.qpos.copy()
    before = camera.exact_depth(qpos)
    qpos[physics.model.joint("object_joint").qposadr[0]] += 0.1
    after = camera.exact_depth(qpos)
    assert np.mean(np.abs(after - before) > 0.02) > 0.01


def test_colour_shows_front_table_and_arm_apart(shot, physics):
    view = shot[0]
    means = {
        name: view.colour[pixels(shot, physics, name)].mean(axis=0)
        for name in ("part_front", "table", "part_handle_bar")
    }
    front, table, handle = means["part_front"], means["table"], means["part_handle_bar"]
    assert front[0] > front[2] + 15  # wood is warm
    assert np.linalg.norm(front - table) > 20
    assert np.linalg.norm(front - handle) > 20


def test_table_in_camera_axes_is_the_plane_z_0(shot, camera, physics, world):
    view, _, geom = shot
    mask = (geom == physics.model.geom("table").id) & (view.depth_m > 0) & (view.depth_m < 1.0)
    points = camera.rig.rays.reshape(*view.depth_m.shape, 3)[mask] * view.depth_m[mask][:, None]
    X = world.camera.X_base_camera_true
    height = points @ X[2, :3] + X[2, 3]
    assert abs(np.median(height)) < 1e-3


def test_sub_pixel_shift_is_found():
    rng = np.random.default_rng(1)
    frequency, phase = rng.uniform(0.02, 0.3, 60), rng.uniform(0, 2 * np.pi, (60, 240))

    def image(shift_px):
        x = np.arange(360) + shift_px
        waves = np.sin(2 * np.pi * frequency[:, None, None] * x + phase[:, :, None]).sum(axis=0)
        return np.clip(np.rint(128 + 14 * waves), 0, 255).astype(np.uint8)

    d = disparity(image(0.0), image(20.25), Matching())
    inner = d[10:-10, 150:-10]
    assert np.mean(inner > 0) > 0.95
    assert np.median(inner[inner > 0]) == pytest.approx(20.25, abs=0.02)
    assert np.std(inner[inner > 0]) < 0.05


def test_message_carries_depth_in_tenths_of_millimetres(shot, camera, world):
    import zlib

    view = shot[0]
    X = world.camera.X_base_camera_reported
    message = to_message(view, "front", 3, 17, camera.rig.K, X)
    depth = np.frombuffer(zlib.decompress(message.depth_u16), "<u2").reshape(480, 848) * message.depth_unit_m
    assert message.depth_unit_m == DEPTH_UNIT_M
    np.testing.assert_allclose(depth, view.depth_m, atol=0.51e-4)
    np.testing.assert_allclose(np.reshape(message.X_base_camera, (4, 4)), X)
    assert (message.width, message.height, message.index, message.stamp_ns) == (848, 480, 3, 17)
