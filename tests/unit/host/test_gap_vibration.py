"""A line in time that nothing of the motion makes, and lines that the motion makes itself."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.rig import write_model
from s2r_host.gap.search import vibration as vibration_module
from s2r_host.gap.search.search import Search
from s2r_host.gap.search.vibration import LEAST_HZ, PER_RECORD, _on, _strongest, unheard_line, vibration

DT = 0.004


def seen(folder, extra, two_tones=True, shaken=0.0):
    """What is said of a joint with an effort ``extra(t, q, dq)`` beyond its model, where nothing was named.

    ``shaken`` moves it at 7.3 Hz beside what was asked for [rad].
    """
    model = RigidModel(write_model(folder / "model.xml"))

    def recorded(index, phase):
        t = np.arange(0, 16, DT)
        q = 0.9 * np.sin(1.7 * t + phase) + two_tones * 0.3 * np.sin(5.3 * t + 2.0 * phase)
        asked = q
        q = q + shaken * np.sin(2.0 * np.pi * 7.3 * t)
        dq = np.gradient(q, DT)
        u = model.inverse(q[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0] + extra(t, q, dq)
        u = u + 0.02 * np.random.default_rng(index).normal(size=len(t))
        channels = {"q": {"elbow": q}, "dq": {"elbow": dq}, "tau": {"elbow": u}, "q_cmd": {"elbow": asked}}
        rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
        return make_session(model, rec, index)

    problem = build_problem(model, [recorded(0, 0.0)], [recorded(2, 1.0)], [recorded(1, 0.0)])
    search = Search(problem)
    return vibration(problem, search, search.finish([], [], []))


def test_a_vibration_is_found_with_frequency_and_size(tmp_path):
    said = seen(tmp_path, lambda t, q, dq: 0.5 * np.sin(2.0 * np.pi * 7.3 * t + 0.4))
    assert said is not None
    assert said[0] == 0
    assert said[1:] == pytest.approx((7.3, 0.5), rel=0.02)


def test_a_vibration_that_moves_the_joint_is_not_taken_for_its_motion(tmp_path):
    said = seen(tmp_path, lambda t, q, dq: 0.5 * np.sin(2.0 * np.pi * 7.3 * t + 0.4), shaken=0.02)
    assert said is not None
    assert said[1:] == pytest.approx((7.3, 0.5), rel=0.1)


def test_a_vibration_that_is_switched_on_and_off_is_read_where_it_is_on(tmp_path):
    said = seen(tmp_path, lambda t, q, dq: 0.5 * np.sin(2.0 * np.pi * 7.3 * t) * ((t > 3.0) & (t < 14.0)))
    assert said is not None
    assert said[1:] == pytest.approx((7.3, 0.5), rel=0.04)


def test_a_line_as_strong_in_every_recording_is_heard_beside_what_is_louder(tmp_path):
    """Notches take more power than the vibration, but no two motions make a line of one strength off their own."""
    said = seen(
        tmp_path, lambda t, q, dq: 0.3 * np.sin(2.0 * np.pi * 7.3 * t + 0.4) + 0.35 * np.sin(20.0 * q)
    )
    assert said is not None
    assert said[1:] == pytest.approx((7.3, 0.3), rel=0.1)


@pytest.mark.parametrize(
    ("extra", "two_tones"),
    [
        (lambda t, q, dq: 0.4 * dq, False),  # one sine, but the motion's own
        (lambda t, q, dq: 0.5 * np.sign(dq), True),
        (lambda t, q, dq: 0.5 * np.sin(20.0 * q), True),
        (lambda t, q, dq: 0.0 * t, True),
    ],
    ids=["viscous friction", "dry friction", "cogging", "nothing"],
)
def test_what_the_motion_makes_is_no_vibration(tmp_path, extra, two_tones):
    assert seen(tmp_path, extra, two_tones) is None


@pytest.mark.parametrize(
    ("rows", "size"), [(12, 1.0), (400, 0.0)], ids=["shorter than its periods", "silent"]
)
def test_a_line_that_cannot_be_switched_on_anywhere_is_on_somewhere(rows, size):
    t = np.arange(rows) * 0.02
    block: Any = SimpleNamespace(session=SimpleNamespace(t=t), picks=np.arange(rows))
    on = _on(block, size * np.sin(2.0 * np.pi * 0.5 * t + 1.0), 0.5)
    assert on.shape == t.shape
    assert on.any()


@pytest.mark.parametrize(("rows", "step"), [(60, 1), (700, 3), (5000, 7)])
def test_the_strongest_line_is_found_without_weighing_every_frequency(monkeypatch, rows, step):
    """They grow with the length as the rows do: 1000 s took longer than all the rest."""
    t = np.arange(rows * step) * DT
    block: Any = SimpleNamespace(
        session=SimpleNamespace(t=t, dt=DT), picks=np.arange(0, len(t), step), rows=slice(0, rows)
    )
    own, top = np.random.default_rng(rows).normal(size=rows), 0.3 / (DT * step)
    width = 1.0 / (PER_RECORD * (rows - 1) * step * DT)
    line, weighed = vibration_module._line, []
    best = max(np.arange(LEAST_HZ, top, width), key=lambda f: float(np.sum(line(block, own, f) ** 2)))
    monkeypatch.setattr(vibration_module, "_line", lambda b, x, f: weighed.append(f) or line(b, x, f))
    assert abs(_strongest([block], own, top) - best) <= 1.24 * width
    assert weighed[0] == best
    assert len(weighed) < 30


PENDULUM = """<body name="{0}"><joint name="{0}" axis="0 1 0" damping="0.1"/>
<inertial mass="1" pos="0 0 -0.2" diaginertia="0.01 0.01 0.001"/></body>"""
TWO = f"<mujoco><worldbody>{PENDULUM.format('a')}{PENDULUM.format('b')}</worldbody></mujoco>"


@pytest.mark.parametrize("loud", [0, 1])
def test_of_two_joints_that_tremble_the_louder_one_is_told(tmp_path, loud):
    (tmp_path / "model.xml").write_text(TWO)
    model = RigidModel(tmp_path / "model.xml")

    def recorded(index, phase):
        t, rng = np.arange(0, 16, DT), np.random.default_rng(index)
        q = np.stack(
            [0.9 * np.sin(w * t + phase) + 0.3 * np.sin(5.3 * t + 2.0 * phase) for w in (1.7, 1.9)], axis=1
        )
        dq = np.gradient(q, DT, axis=0)
        u = model.inverse(q, dq, np.gradient(dq, DT, axis=0)) + 0.02 * rng.normal(size=q.shape)
        u += np.sin(2.0 * np.pi * 7.3 * t + 0.4)[:, None] * np.roll([0.5, 0.3], loud)
        kinds = {"q": q, "dq": dq, "tau": u, "q_cmd": q}
        channels = {kind: {"a": x[:, 0], "b": x[:, 1]} for kind, x in kinds.items()}
        rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
        return make_session(model, rec, index)

    problem = build_problem(model, [recorded(0, 0.0)], [recorded(2, 1.0)], [recorded(1, 0.0)])
    search = Search(problem)
    for said in (vibration(problem, search, search.finish([], [], [])), unheard_line(problem)):
        assert said is not None
        assert said[0] == loud
        assert said[1:] == pytest.approx((7.3, 0.5), rel=0.1)
