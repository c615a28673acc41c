"""The drawer of the stand-in, seen by its stereo camera with the arm in view, becomes a usable model."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from s2r_host.model import build_model
from s2r_host.perception import DepthFrame, estimate_joint
from s2r_protocol.arms import load_arm

PUSH_M = 0.035


@pytest.fixture(scope="module")
def drawer():
    camera = pytest.importorskip("s2r_sim.camera.camera")
    physics = pytest.importorskip("s2r_sim.physics")
    worlds = pytest.importorskip("s2r_sim.world")
    world = worlds.draw_world(5, salt="test")
    arm = load_arm("xmate3pro")
    model = physics.build_world(arm, world)
    q = np.array(model.qpos0)
    for name, value in zip(arm.joint_names, arm.q_home, strict=True):
        q[model.jnt_qposadr[model.joint(name).id]] = value
    slide = model.joint("object_joint").id
    address = model.jnt_qposadr[slide]
    q[address] = world.object.opening_m
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    seen = camera.DepthCamera(model, world.camera)
    frames = []
    for s in (world.object.opening_m, world.object.opening_m - PUSH_M):
        q[address] = s
        image = seen.capture(q)
        frames.append(
            DepthFrame(image.depth_m, seen.rig.K, world.camera.X_base_camera_reported, image.colour)
        )
    estimate = estimate_joint(*frames)
    return world.object, data.xaxis[slide].copy(), estimate


def test_axis_and_push_are_measured(drawer):
    _, axis, estimate = drawer
    assert estimate.joint_type == "prismatic"
    assert np.degrees(np.arccos(-axis @ estimate.axis_direction)) < 1.5
    assert estimate.delta == pytest.approx(PUSH_M, abs=0.001)


def test_handle_gap_and_bar_are_measured_to_millimetres(drawer, tmp_path):
    truth, _, estimate = drawer
    handle = build_model(estimate, tmp_path, outward=True).drawer.handle
    assert handle.gap_m == pytest.approx(truth.handle_gap_m, abs=0.004)
    assert handle.bar_high[0] - handle.bar_low[0] == pytest.approx(truth.handle_bar_m, abs=0.005)
