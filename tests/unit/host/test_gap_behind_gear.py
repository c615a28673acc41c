"""A position read behind a spring: effort and motion of the link alone are those of a rigid joint."""

import numpy as np
import pytest

from s2r_host.gap.motion.behind_gear import links_alone
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model

DT, STIFFNESS, ARMATURE, DAMPING = 0.002, 60.0, 0.05, 0.08


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(
        write_model(tmp_path_factory.mktemp("rig") / "model.xml", damping=DAMPING, armature=ARMATURE)
    )


def derived(x):
    return np.gradient(x, DT)


def geared(model, lost=()):
    """The link's position, the motor's speed and effort; the rows ``lost`` are missing."""
    t = np.arange(0, 12, DT)
    q = 0.5 * np.sin(2.1 * t) + 0.3 * np.sin(9.3 * t + 0.4)
    dq, ddq = derived(q), derived(derived(q))
    rigid = model.inverse(q[:, None], dq[:, None], ddq[:, None])[:, 0]
    windup = (rigid - ARMATURE * ddq - DAMPING * dq) / STIFFNESS
    speed = dq + derived(windup)
    effort = rigid + ARMATURE * derived(derived(windup)) + DAMPING * derived(windup)
    kept = np.ones(len(t), bool)
    kept[list(lost)] = False
    channels = {"q": {"elbow": q[kept]}, "dq": {"elbow": speed[kept]}, "tau": {"elbow": effort[kept]}}
    rec = Recording("r", t[kept], channels, Controller("none"), "measured", "effort", "a", "", ())
    return make_session(model, rec, 0)


def misfit(s):
    inside = slice(200, -200)
    return float(np.sqrt(np.mean((s.u - s.load)[inside] ** 2)))


@pytest.mark.parametrize("lost", [(), (*range(2000, 2006), *range(4100, 4108))])
def test_the_motor_alone_is_taken_off_the_effort(model, lost):
    as_read = geared(model, lost)
    (link,) = links_alone(model, [as_read], [0])
    assert misfit(as_read) > 0.05
    assert misfit(link) < 0.1 * misfit(as_read)
    assert link.index == as_read.index


def test_other_joints_and_recordings_without_speed_are_left_as_they_are(model):
    as_read = geared(model)
    (same,) = links_alone(model, [as_read], [])
    np.testing.assert_array_equal(same.u, as_read.u)
    del as_read.rec.channels["dq"]["elbow"]
    (same,) = links_alone(model, [as_read], [0])
    np.testing.assert_array_equal(same.u, as_read.u)
