"""The motion that splits candidates: inside what was seen, and a plan the executor's side can read."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from s2r_host.gap.output import next_experiment
from s2r_host.gap.output.next_experiment import RATE_HZ, _pair, _write, motions, propose, ranges
from s2r_host.gap.regression.solution import Scored, Term
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


LIMITED = """<mujoco><worldbody><body><joint name="elbow" axis="0 1 0" limited="true" range="-1 3"/>
<inertial mass="1" pos="0 0 -1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""


def limited() -> Any:
    model = mujoco.MjModel.from_xml_string(LIMITED.replace("<mujoco>", '<mujoco><compiler angle="radian"/>'))
    return SimpleNamespace(model=model, joints=["elbow"], unit=lambda joint: "rad")


def decided(verdict, slot, effects=(), off=()) -> Any:
    scored = [Scored(Term(name, 0), 1.0, 1.0, 0.5, np.zeros(0)) for name in slot]
    solution = SimpleNamespace(slots=[scored], terms=[scored[0].term])
    named = [SimpleNamespace(could_also_be=also) for also in effects]
    return SimpleNamespace(verdict=verdict, solution=solution, effects=named, parameters_off=list(off))


def test_the_range_seen_comes_first_and_then_that_of_the_model_with_a_margin():
    seen, wide = ranges(limited(), 0, (0.0, 0.5))
    assert seen == (0.0, 0.5, "")
    assert wide[:2] == pytest.approx((-0.8, 2.8))
    assert "leaves the range seen and moves 'elbow' between -0.8 and 2.8 rad" in wide[2]
    assert ranges(limited(), 0, (-0.9, 2.8)) == [(-0.9, 2.8, "")]


def test_the_rival_is_what_the_answer_holds_possible_and_numbers_have_one_too():
    slot = ["payload", "armature", "effort_scale"]
    pair = _pair(decided("parameter_off", slot, off=[{"could_also_be": ["effort_scale"]}]))
    assert pair is not None
    assert [t.effect for t in pair] == ["payload", "effort_scale"]
    assert _pair(decided("parameter_off", slot, off=[{}])) is None
    pair = _pair(decided("physics_missing", slot, effects=[[]]))
    assert pair is not None
    assert [t.effect for t in pair] == ["payload", "armature"]


def proposed(tmp_path, monkeypatch, differences):
    """What is proposed where the best motion of each range splits by so many floors, and the ranges asked about."""
    asked = []

    def most_different(_a, _j, _twins, tried):
        asked.append(max(float(q.max()) for q in tried.values()))
        return "slow ramp both ways", tried["slow ramp both ways"], differences[len(asked) - 1]

    monkeypatch.setattr(next_experiment, "_most_different", most_different)
    monkeypatch.setattr(next_experiment, "_twin_of", lambda *_: None)
    ctx = SimpleNamespace(span=lambda j: (0.0, 0.5), top_speed=lambda j: 2.0)
    fit = [SimpleNamespace(q=np.zeros((10, 1)), a=np.full((10, 1), 5.0))]
    a: Any = SimpleNamespace(model=limited(), fit=fit, problem=SimpleNamespace(ctx=ctx), search=True)
    slot = ["cable_spring", "spring_return"]
    return propose(a, decided("physics_missing", slot, effects=[slot[1:]]), tmp_path), asked


def test_a_motion_that_splits_nothing_is_not_handed_out(tmp_path, monkeypatch):
    found, asked = proposed(tmp_path, monkeypatch, [0.1, 0.2])
    assert len(asked) == 2
    assert found["separates"] == []
    assert found["trajectory"] is None
    assert found["predicted_floors"] == 0.2
    assert "no motion within the limits splits cable_spring from spring_return" in found["why"]
    assert "at most 0.2 noise floors" in found["why"]
    assert not list(tmp_path.iterdir())


def test_the_model_range_is_used_only_where_the_range_seen_splits_nothing(tmp_path, monkeypatch):
    found, asked = proposed(tmp_path, monkeypatch, [0.1, 4.0])
    assert asked[0] <= 0.5 + 1e-9 < asked[1]
    assert found["separates"] == ["cable_spring", "spring_return"]
    assert "differ by 4.0 noise floors" in found["why"]
    assert "leaves the range seen" in found["why"]
    assert (tmp_path / "next_experiment.mcap").exists()
    found, asked = proposed(tmp_path, monkeypatch, [4.0])
    assert len(asked) == 1
    assert "leaves the range seen" not in found["why"]
