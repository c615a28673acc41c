"""A spring with a loop is a cable where its rest lies amid the travel, and two things where it pulls one way."""

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.rig import write_model
from s2r_host.gap.search.search import Search

STIFFNESS, LOOP, WIDTH = 0.6, 0.15, 0.15


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml"))


def loop(q):
    """Bouc-Wen with an exponent of two: dz = dq/width (1 - z|z| sign dq)."""
    z = np.zeros(len(q))
    for i, step in enumerate(np.diff(q)):
        z[i + 1] = z[i] + step / WIDTH * (1.0 - z[i] * abs(z[i]) * np.sign(step))
    return z


@pytest.mark.parametrize(("rest", "names"), [(0.1, {"cable_spring"}), (1.5, {"spring_return", "hysteresis"})])
def test_where_the_rest_lies_says_what_the_loop_belongs_to(model, swung, rest, names):
    def hidden(q, dq):
        return STIFFNESS * (q - rest) + LOOP * loop(q)

    fit, again, held = (swung(model, k, phase, hidden) for k, phase in ((0, 0.0), (1, 0.0), (2, 1.0)))
    solution = Search(build_problem(model, [fit], [held], [again])).run()
    assert {t.effect for t in solution.terms} == names
