"""Friction that is more at rest, seen in nothing but the effort of a start."""

import itertools

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.friction_edge import find_edges
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.search.break_away import break_away
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.decide import decide

DT, FINE, FRICTION, DAMPING, INERTIA = 0.002, 20, 0.3, 0.05, 0.02
KP, KD, SPEED, NOISE = 60.0, 2.0, 0.05, 0.004
TABLE = f"""<mujoco><worldbody><body name="plate">
  <joint name="table" axis="0 0 1" damping="{DAMPING}" frictionloss="{FRICTION}"/>
  <inertial mass="1" pos="0 0 0" diaginertia="0.01 0.01 {INERTIA}"/></body></worldbody></mujoco>"""


def moved(model, index, *, excess=0.0, spring=0.0, places=(0.0, 0.15, -0.1, 0.2, 0.05, -0.15, 0.0)):
    """Slow ramps with rests between them under PD control; dry friction sticks, at rest by ``excess`` more [N·m]."""
    rng, way = np.random.default_rng(index), [np.zeros(300)]
    for a, b in itertools.pairwise(places):
        way += [np.linspace(a, b, round(abs(b - a) / SPEED / DT)), np.full(400, b)]
    command, q, v, step = np.concatenate(way), 0.0, 0.0, DT / FINE
    rate = np.gradient(command, DT)
    log = np.zeros((len(command), 3))
    for k, (to, fast) in enumerate(zip(command, rate, strict=True)):
        u = KP * (to - q) + KD * (fast - v)
        log[k] = q, v, u
        for _ in range(FINE):
            push = u - DAMPING * v - spring * q
            if v == 0.0 and abs(push) <= FRICTION + excess:
                continue
            way_on = np.sign(v) if v else np.sign(push)
            after = v + step * (push - FRICTION * way_on) / INERTIA
            v = 0.0 if v and after * v <= 0.0 else after
            q += step * v
    t = DT * np.arange(len(command))
    columns = {"q": log[:, 0], "dq": log[:, 1], "tau": log[:, 2] + NOISE * rng.normal(size=len(t))}
    channels = {kind: {"table": x} for kind, x in columns.items()}
    rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
    return make_session(model, rec, index)


def searched(folder, skip=frozenset(), **hidden):
    (folder / "table.xml").write_text(TABLE, encoding="utf-8")
    model = RigidModel(folder / "table.xml")
    fit = [moved(model, k, **hidden) for k in (0, 1)]
    find_edges(fit, model)
    return Search(build_problem(model, fit, [], []), skip)


def test_every_start_takes_what_friction_at_rest_has_more(tmp_path):
    problem = searched(tmp_path, excess=0.12).problem
    found = break_away(problem, 0)
    assert found is not None
    assert found.excess == pytest.approx(0.12, abs=0.035)  # filters blunt a peak
    assert found.deviation < 0.02
    assert 0.0 < found.speed < SPEED
    assert len(found.intervals) >= 8


@pytest.mark.parametrize(
    "hidden",
    [
        {},
        {"spring": 0.5},  # pulls harder at one place than at another, but before a start as after it
        {"excess": 0.12, "places": (0.0, 0.15)},  # one start is no evidence
    ],
)
def test_without_it_or_with_one_start_there_is_none(tmp_path, hidden):
    assert break_away(searched(tmp_path, **hidden).problem, 0) is None


def test_it_is_named_with_its_size_and_a_bound_on_its_speed(tmp_path):
    search = searched(tmp_path, excess=0.12)
    decision = decide(search.problem, search)
    assert [(e.name, e.joint) for e in decision.effects] == [("stribeck", "table")]
    found = decision.effects[0].parameters
    assert found["static_excess"]["interval90"][0] < 0.12 < found["static_excess"]["interval90"][1]
    assert not found["speed"]["identifiable"]
    assert decision.solution.terms[-1].effect == "stribeck"
    assert len(decision.solution.theta) == len(decision.solution.terms) == len(decision.solution.covariance)


def test_where_the_catalogue_does_not_know_it_the_place_is_said_all_the_same(tmp_path):
    search = searched(tmp_path, frozenset({"stribeck"}), excess=0.12)
    decision = decide(search.problem, search)
    assert decision.verdict == "unknown"
    assert decision.touched is not None
    assert "starts from rest" in decision.reasons[-1]
