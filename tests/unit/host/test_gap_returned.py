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


def test_a_loop_that_turns_back_nearly_straight_needs_no_spring_beside_it(model, swung):
    """Bouc-Wen as another lab writes it, dz = dq/width - (0.6 |dq| z + 0.4 dq |z|)/width: neither Dahl's nor square."""

    def hidden(q, dq):
        z = np.zeros(len(q))
        for i, step in enumerate(np.diff(q)):
            z[i + 1] = z[i] + step / WIDTH - (0.6 * abs(step) * z[i] + 0.4 * step * abs(z[i])) / WIDTH
        return 4.0 * LOOP * z

    fit, again, held = (swung(model, k, phase, hidden) for k, phase in ((0, 0.0), (1, 0.0), (2, 1.0)))
    solution = Search(build_problem(model, [fit], [held], [again])).run()
    assert [t.effect for t in solution.terms] == ["hysteresis"]
    assert dict(solution.terms[0].shape)["beta"] == pytest.approx(0.6, abs=0.05)
