"""Regressors pass the filters that the signals they are compared with have passed, no more and no fewer."""

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.solution import Term
from s2r_host.gap.search.search import Search

WHEEL = """<mujoco><worldbody><body name="wheel"><joint name="spindle" damping="0.2" frictionloss="0.1"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/></body></worldbody></mujoco>"""
DT = 0.002
NO_MOTOR = (frozenset[str](), frozenset({"armature"}))


@pytest.fixture(scope="module")
def search(tmp_path_factory):
    path = tmp_path_factory.mktemp("wheel") / "model.xml"
    path.write_text(WHEEL)
    model, rng = RigidModel(path), np.random.default_rng(0)
    t = np.arange(0.0, 10.0, DT)
    q = np.sin(2.0 * t) + 0.05 * np.sin(70.0 * t)
    v = np.gradient(q, DT)
    tau = 0.05 * np.gradient(v, DT) + 0.2 * v + 0.1 * np.tanh(v / 0.01) + 0.01 * rng.normal(size=len(t))
    channels = {"q": {"spindle": q + 1e-4 * rng.normal(size=len(t))}, "tau": {"spindle": tau}}
    rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    return Search(build_problem(model, [make_session(model, rec, 0)], [], []))


@pytest.mark.parametrize(("effect", "number"), [("armature", "inertia"), ("viscous_friction", "damping")])
def test_an_effect_that_is_a_number_of_the_model_can_be_made_up_for_by_it_exactly(search, effect, number):
    p = search.problem
    (k,) = (i for i, b in enumerate(p.base) if b.name == number)
    column = search.matrix(Term(effect, 0))[0][:, 0]
    assert p.B[:, k] == pytest.approx(p.base[k].size * column, abs=1e-9 * np.abs(p.B[:, k]).max())


def test_a_skipped_effect_is_no_number_of_the_model_either(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(WHEEL.replace("<joint ", '<joint armature="0.01" '))
    model = RigidModel(path)
    t = np.arange(0.0, 4.0, DT)
    channels = {"q": {"spindle": np.sin(2.0 * t)}, "tau": {"spindle": np.cos(2.0 * t)}}
    rec = Recording("r", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    problem = build_problem(model, [make_session(model, rec, 0)], [], [])
    named = [any("armature" in name for name in Search(problem, skip).effects) for skip in NO_MOTOR]
    assert named == [True, False]


def test_a_part_made_from_filtered_motion_passes_the_second_filter_only(search):
    p = search.problem
    a = {b.session.index: b.session.a[:, 0] for b in p.blocks}
    step = {b.session.index: b.session.sign(0) for b in p.blocks}
    both = {k: a[k] + step[k] for k in a}
    assert p.whiten(both, 0, a) == pytest.approx(p.whiten(a, 0, a) + p.whiten(step, 0))
    assert np.abs(p.whiten(a, 0, a) - p.whiten(a, 0)).max() > 1e-3 * np.abs(p.whiten(a, 0)).max()
