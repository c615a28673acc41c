"""A joint that swings, as a recording with slow noise and something hidden in its effort; a lever seen twice, and
one at the fingertip."""

import numpy as np
import pytest
from scipy.signal import lfilter

from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.motion.arm_model import ArmModel
from s2r_host.perception import synthetic
from s2r_host.perception.change import compare
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.view import DepthView
from s2r_host.run.belief import Belief
from s2r_host.run.measure import PartTemplate
from s2r_protocol.arms import load_arm

DT = 0.004


@pytest.fixture
def swung():
    """``swung(model, index, phase, hidden)`` with ``hidden(q, dq)`` the effort the model lacks [N·m]: a session."""

    def made(model, index, phase, hidden):
        rng = np.random.default_rng(index)
        t = np.arange(0, 20, DT)
        q = 0.6 * np.sin(1.7 * t + phase) + 0.2 * np.sin(5.3 * t + 2.0 * phase)
        dq = np.gradient(q, DT)
        noise = np.asarray(lfilter([0.2], [1.0, -0.9], rng.normal(size=len(t))))
        u = model.inverse(q[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0]
        u = u + hidden(q, dq) + 0.02 * noise / np.std(noise)
        channels = {"q": {"elbow": q}, "dq": {"elbow": dq}, "tau": {"elbow": u}}
        rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
        return make_session(model, rec, index)

    return made


@pytest.fixture(scope="session")
def lever_on_column():
    """``lever_on_column(lever, turn, below_m)``: two views of a box that turned about an upright column on a table.

    The column ends ``below_m`` [m] below the turn's origin.
    """

    def made(lever, turn, below_m=0.01):
        pivot, table = turn.origin, np.eye(4)
        table[:3, 3] = (0.7, 0.0, -0.01)
        static = [
            synthetic.Box(table, np.array([1.2, 1.2, 0.02])),
            synthetic.beam(pivot * (1.0, 1.0, 0.0), pivot - (0.0, 0.0, below_m), 0.04, 0.04),
        ]
        K, camera = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]]), np.array([0.0, -0.35, 0.6])
        X = synthetic.look_at(camera, pivot)
        pair = synthetic.pair(static, [lever], turn, K, (360, 640), X, np.random.default_rng(3))
        before, after = DepthView(pair.before), DepthView(pair.after)
        everywhere = np.ones(len(before.points), bool), np.ones(len(after.points), bool)
        return Scene(before, after, compare(before, after), *everywhere)

    return made


@pytest.fixture(scope="session")
def arm():
    return ArmModel(load_arm("xmate3pro"))


@pytest.fixture
def lever_at_tip(arm, tmp_path):
    """A lever 10 mm thick about an upright axis 12 cm beside the fingertip at home, which it reaches beyond."""
    x, y, z = arm.tool_pose(arm.arm.q_home)[:3, 3]
    path = tmp_path / "lever.xml"
    path.write_text(
        f"""<mujoco><compiler angle="radian"/><worldbody><body name="object_base"/><body name="object_part">
        <joint name="object_joint" axis="0 0 1" pos="{x} {y - 0.12} {z}" range="-1 1"/>
        <geom name="part_lever" type="box" pos="{x} {y - 0.06} {z}" size="0.005 0.08 0.03"/>
        </body></worldbody></mujoco>"""
    )
    hinge = JointMotion("revolute", np.array([x, y - 0.12, z]), np.array([0.0, 0.0, 1.0]), 0.0)
    template = PartTemplate(np.zeros((1, 3)), np.array([[-1.0, 0.0, 0.0]]), hinge)
    return Belief(None, None, template, path, path, {})  # type: ignore[arg-type]
