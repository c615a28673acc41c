"""A bus that is late is late for every joint of an arm: one cause, named on all of them."""

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.search.everywhere import late_everywhere
from s2r_host.gap.search.search import Search

DT, NOISE = 0.004, np.array([0.02, 0.02, 0.01])
ARM_XML = """<mujoco><worldbody><body name="a">
<joint name="j1" axis="0 0 1" damping="0.2" frictionloss="0.4" armature=".05"/>
<inertial mass="3" pos="0.1 0 0.1" diaginertia="0.02 0.02 0.02"/>
<body name="b" pos="0 0 0.2"><joint name="j2" axis="0 1 0" damping="0.2" frictionloss="0.4" armature=".05"/>
<inertial mass="2" pos="0.15 0 0.05" diaginertia="0.02 0.02 0.02"/>
<body name="c" pos="0.3 0 0"><joint name="j3" axis="0 1 0" damping="0.1" frictionloss="0.2" armature=".02"/>
<inertial mass="1" pos="0.1 0 0.02" diaginertia="0.005 0.005 0.005"/>
</body></body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "model.xml"
    path.write_text(ARM_XML)
    return RigidModel(path)


def recorded(model, index, phase, late):
    """Ten seconds in which joint k is asked ``late[k]`` before its effort arrives [s]."""
    rng = np.random.default_rng(index)
    t = np.arange(0.0, 10.0, DT)
    f = np.array([0.7, 0.9, 1.3])
    q = 0.4 * np.sin(2 * np.pi * f * t[:, None] + phase) + 0.1 * np.sin(7.0 * np.pi * f * t[:, None])
    v = np.gradient(q, DT, axis=0)
    a = np.gradient(v, DT, axis=0)
    tau = model.inverse(q, v, a) + model.model.dof_frictionloss * np.tanh(v / 0.01)
    asked = np.stack([np.interp(t + late[k], t, tau[:, k]) for k in range(3)], axis=1)
    asked += NOISE * rng.normal(size=q.shape)
    channels = {
        kind: {j: x[:, k] for k, j in enumerate(model.joints)}
        for kind, x in (("q", q), ("dq", v), ("tau", asked))
    }
    return make_session(
        model, Recording(f"r{index}", t, channels, Controller(), "commanded", "effort", "a", "", ()), index
    )


def searched(model, late):
    fit, again, held = (recorded(model, k, p, late) for k, p in ((0, 0.0), (1, 0.0), (2, 1.0)))
    return Search(build_problem(model, [fit], [held], [again]))


def test_a_late_bus_is_named_on_all_joints(model):
    terms, slots = late_everywhere(searched(model, (0.01, 0.01, 0.01)), [])
    assert sorted(t.key for t in terms) == [("actuator_delay", k) for k in range(3)]
    assert [dict(t.shape)["delay"] for t in terms] == pytest.approx([0.01] * 3, rel=0.15)
    assert all(len(slot) >= 1 and slot[0].gain > 12.0 for slot in slots)


@pytest.mark.parametrize("late", [(0.0, 0.0, 0.0), (0.0, 0.012, 0.0), (0.004, 0.012, 0.04)])
def test_one_late_joint_and_drives_that_differ_are_left_to_the_search(model, late):
    assert late_everywhere(searched(model, late), []) == ([], [])
