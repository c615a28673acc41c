"""Columns of two joints that have changed places: the control law gives them away."""

import numpy as np
import pytest

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion.checks import check_gains
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording

XML = """<mujoco><worldbody><body name="a"><joint name="j1" axis="0 0 1"/>
<inertial mass="3" pos="0.2 0 0" diaginertia="0.02 0.02 0.02"/>
<body name="b" pos="0.4 0 0"><joint name="j2" axis="0 0 1"/>
<inertial mass="1" pos="0.1 0 0" diaginertia="0.004 0.004 0.004"/></body></body></worldbody></mujoco>"""
KP, KD, DT = {"j1": 400.0, "j2": 90.0}, {"j1": 30.0, "j2": 5.0}, 0.005


def session(folder, names, kp=KP, kd=KD):
    """Eight seconds under the law, the columns of both joints under ``names``."""
    (folder / "model.xml").write_text(XML)
    model = RigidModel(folder / "model.xml")
    t = np.arange(0, 8, DT)
    q = np.stack([0.5 * np.sin(1.7 * t), 0.6 * np.sin(2.9 * t + 1.0)], axis=1)
    dq = np.gradient(q, DT, axis=0)
    effort = model.inverse(q, dq, np.gradient(dq, DT, axis=0))
    asked = q + effort / np.array([KP["j1"], KP["j2"]])
    channels = {
        kind: {name: x[:, k] for k, name in enumerate(names)}
        for kind, x in (("q", q), ("dq", dq), ("q_cmd", asked), ("dq_cmd", dq), ("tau", effort))
    }
    law = Controller("pd", dict(kp), dict(kd), {}, 1000.0)
    rec = Recording("r", t, channels, law, "commanded", "q_cmd", "a", "", ())
    return model, make_session(model, rec, 0)


def test_swapped_joints_are_refused_by_name(tmp_path):
    with pytest.raises(GapRecordingError, match=r"'j1' follows the gains declared for 'j2'.*joint_names"):
        check_gains(*session(tmp_path, ("j2", "j1")))


def test_joints_in_their_places_pass(tmp_path):
    check_gains(*session(tmp_path, ("j1", "j2")))


def test_gains_that_are_off_are_no_swap(tmp_path):
    check_gains(*session(tmp_path, ("j1", "j2"), kp={"j1": 300.0, "j2": 120.0}))


def test_joints_with_equal_gains_pass(tmp_path):
    check_gains(*session(tmp_path, ("j1", "j2"), kp={"j1": 400.0, "j2": 400.0}, kd={"j1": 30.0, "j2": 30.0}))
