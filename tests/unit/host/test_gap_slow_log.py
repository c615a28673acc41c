"""Slow logs: what is rebuilt between their rows, and what stays open."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from s2r_host.gap.motion.law import check_law
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.motion.slow_log import filled
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.friction_edge import find_edges
from s2r_host.gap.regression.friction_seen import between_level
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.regression.seeds import fill_residuals
from s2r_host.gap.rig import write_model
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.decide import decide

DT, EVERY = 0.001, 100
KP, KD, FRICTION = 60.0, 6.0, 0.05
TONES = ((0.5, 0.31, 0.0), (0.25, 1.1, 0.4), (0.12, 2.3, 1.1))
LSB = 1e-4


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml", FRICTION, 0.0))


def motion(t, phase):
    turns = [(a, 2.0 * np.pi * f, p + phase) for a, f, p in TONES]
    q = np.sum([a * np.sin(w * t + p) for a, w, p in turns], axis=0)
    v = np.sum([a * w * np.cos(w * t + p) for a, w, p in turns], axis=0)
    return q, v, np.sum([-a * w**2 * np.sin(w * t + p) for a, w, p in turns], axis=0)


def logged(model, index, phase, damping, every=EVERY, law=True):
    """A joint that needs ``damping`` more effort than its model, logged every so many ticks of its PD loop."""
    rng = np.random.default_rng(index)
    t = np.arange(0.0, 20.0, DT)
    q, v, a = motion(t, phase)
    u = model.inverse(q[:, None], v[:, None], a[:, None])[:, 0] + FRICTION * np.tanh(v / 0.01) + damping * v
    u += 0.01 * np.sin(2.0 * np.pi * 0.7 * t + rng.uniform(0.0, 6.0))
    q, v = np.round(q / LSB) * LSB, v + rng.normal(0.0, 1e-3, len(t))
    dq_cmd = motion(t, phase)[1]
    q_cmd = (u - KD * (dq_cmd - v)) / KP + q  # the command that makes the loop ask for just this effort
    rows = {"q": q, "dq": v, "tau": u, "q_cmd": q_cmd, "dq_cmd": dq_cmd}
    channels = {kind: {"elbow": x[::every]} for kind, x in rows.items()}
    loop = Controller("pd", {"elbow": KP}, {"elbow": KD}, {}, 1000.0) if law else Controller()
    return Recording(
        f"r{index}", t[::every], channels, loop, "commanded", "q_cmd" if law else "effort", "a", "", ()
    )


def test_position_and_speed_together_give_the_acceleration_between_slow_rows(model):
    rec = filled(model, logged(model, 0, 0.0, 0.0))
    inner = (rec.t > 0.5) & (rec.t < 19.0)
    truth = motion(rec.t, 0.0)[2]
    rebuilt = CubicSpline(rec.t, rec.channels["dq"]["elbow"])(rec.t, 1)
    plain = CubicSpline(rec.rows.t, rec.rows.channels["dq"]["elbow"])(rec.t, 1)
    error = np.std((rebuilt - truth)[inner])
    assert rec.dt <= 0.005
    assert error < 0.02 * np.std(truth)
    assert error < 0.5 * np.std((plain - truth)[inner])


def test_fast_logs_and_logs_without_speed_stay_as_they_are(model):
    fast = logged(model, 0, 0.0, 0.0, every=4)
    assert filled(model, fast) is fast
    slow = logged(model, 0, 0.0, 0.0)
    del slow.channels["dq"]
    assert filled(model, slow) is slow


def test_the_effort_between_rows_is_what_the_law_asks_for(model):
    rec = filled(model, logged(model, 0, 0.0, 0.3))
    t = np.arange(0.0, 20.0, DT)
    q, v, a = motion(t, 0.0)
    true = model.inverse(q[:, None], v[:, None], a[:, None])[:, 0] + FRICTION * np.tanh(v / 0.01) + 0.3 * v
    inner = (rec.t > 0.5) & (rec.t < 19.0)
    error = (rec.channels["tau"]["elbow"] - np.interp(rec.t, t, true))[inner]
    assert np.std(error) < 0.05 * np.std(true)
    assert np.all(rec.effort_doubt["elbow"] >= 0.0)


def named(model, damping):
    sessions = [
        make_session(model, filled(model, logged(model, k, phase, damping)), k)
        for k, phase in enumerate((0.0, 0.0, 1.3))
    ]
    find_edges(sessions, model)
    fit, again, held = sessions
    problem = build_problem(model, [fit], [held], [again])
    fill_residuals(problem)
    return decide(problem, Search(problem))


def test_damping_is_named_from_ten_rows_per_second_and_nothing_when_there_is_none(model):
    found = named(model, 0.08)
    assert [e.name for e in found.effects] == ["viscous_friction"]
    assert found.effects[0].parameters["coefficient"]["value"] == pytest.approx(0.08, rel=0.1)
    assert named(model, 0.0).verdict == "nothing_missing"


def test_a_commanded_speed_that_was_not_logged_is_read_off_the_command(model):
    """With its damping counted from rest such a law misses by several times the effort: gains off, or late stamps."""
    rec = logged(model, 0, 0.0, 0.0, every=1)
    behind = lfilter(
        [DT / KD], [1.0, DT * KP / KD - 1.0], rec.channels["tau"]["elbow"]
    )  # what KP e + KD de/dt = tau leaves the joint behind
    rec.channels["q_cmd"]["elbow"] = motion(rec.t, 0.0)[0] + behind
    rows = {k: {j: x[::20] for j, x in table.items()} for k, table in rec.channels.items() if k != "dq_cmd"}
    session = make_session(model, filled(model, replace(rec, t=rec.t[::20], channels=rows)), 0)
    assert check_law(model, [session], [], 0) is None


def test_fewer_rows_leave_more_open(model):
    slow, slower = (
        make_session(model, filled(model, logged(model, 0, 0.0, 0.0, every)), 0) for every in (40, 100)
    )
    assert 0.0 < between_level(model, [slow], 0) < between_level(model, [slower], 0)
