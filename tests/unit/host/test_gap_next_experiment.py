"""The motion that splits candidates: inside what was seen, and a plan the executor's side can read."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.gap.output.next_experiment import RATE_HZ, _write, motions
from s2r_host.replay.sources import read_source
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")


@pytest.mark.parametrize(("speed", "acceleration"), [(0.5, 0.8), (2.0, 5.0)])
def test_every_candidate_motion_stays_inside_speed_and_acceleration_seen(speed, acceleration):
    for name, q in motions(-0.4, 0.9, speed, acceleration).items():
        dq = np.gradient(q) * RATE_HZ
        assert np.max(np.abs(dq)) <= speed * 1.001, name
        assert np.max(np.abs(np.gradient(dq) * RATE_HZ)) <= acceleration * 1.001, name
        assert q.min() >= -0.4 - 1e-9, name
        assert q.max() <= 0.9 + 1e-9, name


def test_the_motion_is_a_plan_of_the_arm_that_replay_reads(tmp_path):
    q_home = np.tile(ARM.q_home, (10, 1))
    analysis = SimpleNamespace(model=SimpleNamespace(joints=ARM.joint_names), fit=[SimpleNamespace(q=q_home)])
    q = motions(ARM.q_home[1] - 0.2, ARM.q_home[1] + 0.2, 0.5, 1.0)["slow ramp both ways"]
    _write(tmp_path / "next_experiment.csv", analysis, 1, q)
    (plan,) = read_source(tmp_path / "next_experiment.mcap", ARM)
    knots = plan.trajectory
    assert np.allclose(knots.q[:, 0], ARM.q_home[0])
    assert np.allclose(knots.q[:, 1], q[:: len(q) // len(knots.q)][: len(knots.q)], atol=1e-6)
    assert not knots.dq[[0, -1]].any()
