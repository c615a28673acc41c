"""A controller that is simulated goes on where the recorded one stood."""

import numpy as np
import pytest

from s2r_host.gap.effects.base import Context
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model
from s2r_host.gap.simulation.replay import build_twin, run

DT, KP, KD, KI = 0.004, 40.0, 2.0, 60.0


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


@pytest.mark.parametrize("off", [0.0, 3.0])
def test_the_integral_of_a_loop_holds_what_is_not_fed_forward(model, off):
    """What is fed forward is ``off`` [N·m] too much, and the integral takes it away again."""
    t = np.arange(0, 6, DT)
    q = 0.6 * np.sin(1.7 * t) + 0.4
    dq, ddq = np.gradient(q, DT), np.gradient(np.gradient(q, DT), DT)
    u = model.inverse(q[:, None], dq[:, None], ddq[:, None])[:, 0]
    channels = {
        "q": {"elbow": q}, "dq": {"elbow": dq}, "tau": {"elbow": u},
        "q_cmd": {"elbow": q}, "dq_cmd": {"elbow": dq}, "tau_ff": {"elbow": u + off},
    }  # fmt: skip
    law = Controller("pid", {"elbow": KP}, {"elbow": KD}, {"elbow": KI}, 250.0)
    s = make_session(model, Recording("r", t, channels, law, "commanded", "q_cmd", "a", "", ()), 0)
    start = 100
    motion = run(build_twin(model, Context(model, [s]), []), s, start, len(t) - start, closed=True)
    assert np.max(np.abs(motion.q[:, 0] - s.q[start : len(t) - start, 0])) < 0.01
