"""A spring with a loop is a cable where its rest lies amid the travel, and two things where it pulls one way."""

import numpy as np
import pytest
from scipy.signal import lfilter

from s2r_host.gap.model import RigidModel
from s2r_host.gap.problem import build_problem
from s2r_host.gap.recording import Controller, Recording
from s2r_host.gap.rig import write_model
from s2r_host.gap.search import Search
from s2r_host.gap.session import make_session

DT, STIFFNESS, LOOP, WIDTH = 0.004, 0.6, 0.15, 0.15


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


def loop(q):
    """Bouc-Wen with an exponent of two: dz = dq/width (1 - z|z| sign dq)."""
    z = np.zeros(len(q))
    for i, step in enumerate(np.diff(q)):
        z[i + 1] = z[i] + step / WIDTH * (1.0 - z[i] * abs(z[i]) * np.sign(step))
    return z


def recorded(model, index, phase, rest):
    rng = np.random.default_rng(index)
    t = np.arange(0, 20, DT)
    q = 0.6 * np.sin(1.7 * t + phase) + 0.2 * np.sin(5.3 * t + 2.0 * phase)
    dq = np.gradient(q, DT)
    noise = np.asarray(lfilter([0.2], [1.0, -0.9], rng.normal(size=len(t))))
    u = model.inverse(q[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0]
    u = u + STIFFNESS * (q - rest) + LOOP * loop(q) + 0.02 * noise / np.std(noise)
    channels = {"q": {"elbow": q}, "dq": {"elbow": dq}, "tau": {"elbow": u}}
    rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    return make_session(model, rec, index)


@pytest.mark.parametrize(("rest", "names"), [(0.1, {"cable_spring"}), (1.5, {"spring_return", "hysteresis"})])
def test_where_the_rest_lies_says_what_the_loop_belongs_to(model, rest, names):
    fit, again, held = (recorded(model, k, phase, rest) for k, phase in ((0, 0.0), (1, 0.0), (2, 1.0)))
    solution = Search(build_problem(model, [fit], [held], [again])).run()
    assert {t.effect for t in solution.terms} == names
