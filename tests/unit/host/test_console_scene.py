"""The arm in the 3D view: bodies hang on one another, so what is sent has to compose to where they are."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest

from s2r_host.console.scene import ArmView
from s2r_host.report.arm_shapes import ArmShapes
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")


class Node:
    """A scene node that counts what it is sent."""

    def __init__(self, name):
        self.name, self.sent, self.visible = name, 0, True
        self.pose = {"position": np.zeros(3), "wxyz": np.array([1.0, 0, 0, 0])}

    def __setattr__(self, name, value):
        if name in ("position", "wxyz"):
            self.sent += 1
            self.pose[name] = np.asarray(value)
        else:
            super().__setattr__(name, value)


class Scene:
    def __init__(self):
        self.nodes = {}

    def _add(self, name, *args, **options):
        self.nodes[name] = Node(name)
        return self.nodes[name]

    add_frame = add_mesh_simple = _add

    def pose(self, name):
        """Of a node in the world, through all its parents."""
        parts = name.strip("/").split("/")
        X = np.eye(4)
        for k in range(1, len(parts) + 1):
            pose = self.nodes["/" + "/".join(parts[:k])].pose
            w, x, y, z = pose["wxyz"]
            own = np.eye(4)
            own[:3, :3], own[:3, 3] = pin.Quaternion(w, x, y, z).matrix(), pose["position"]
            X = X @ own
        return X

    @property
    def sent(self):
        return sum(node.sent for node in self.nodes.values())


@pytest.fixture(scope="module")
def shapes():
    return ArmShapes(ARM)


def test_bodies_are_shown_where_the_kinematics_put_them(shapes):
    scene = Scene()
    view = ArmView(scene, shapes, "real", ((0, 0, 0),))
    rng = np.random.default_rng(0)
    for _ in range(3):
        q = rng.uniform(ARM.limits.q_min, ARM.limits.q_max)
        view.show(q)
        bodies = [name for name in scene.nodes if name != "/real"]
        shown = np.array([scene.pose(name) for name in bodies])
        np.testing.assert_allclose(shown, shapes.poses(q), atol=1e-4)


def test_an_arm_is_shown_when_that_is_asked_for_only(shapes):
    """A ghost is moved along while it is hidden."""
    scene = Scene()
    view = ArmView(scene, shapes, "plan", ((0, 0, 0),))
    view.show(ARM.q_home)
    assert not scene.nodes["/plan"].visible
    view.visible = True
    view.show(ARM.q_home + 0.1)
    assert scene.nodes["/plan"].visible


def test_one_moving_joint_is_one_message(shapes):
    scene = Scene()
    view = ArmView(scene, shapes, "real", ((0, 0, 0),))
    view.show(ARM.q_home)
    before = scene.sent
    view.show(ARM.q_home)
    assert scene.sent == before
    q = ARM.q_home.copy()
    q[2] += 0.1
    view.show(q)
    assert scene.sent == before + 1


def test_the_console_starts_without_perception_planning_and_plots():
    """They take seconds to import, and a page that shows and stops needs none of them."""
    code = (
        "import sys, s2r_host.console.app\n"
        "heavy = {'open3d', 'matplotlib', 'toppra', 'onnxruntime', 'cv2', 'coacd'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr
