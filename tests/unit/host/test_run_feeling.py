"""What the belief makes of what the arm felt."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from s2r_host.perception.motion import JointMotion
from s2r_host.proprioception.object_log import Touch, write_log
from s2r_host.report.felt import felt_figure
from s2r_host.run import feeling as feeling_module
from s2r_host.run.belief import HOLDING, Belief
from s2r_host.run.feeling import Feeling, with_felt
from s2r_host.run.measure import PartTemplate
from s2r_host.run.task import DRAWER as DRAWER_TASK

LID = """<mujoco><compiler angle="radian"/><worldbody><body name="object_base"/><body name="object_part">
<joint name="object_joint" axis="0 -1 0" range="-1 1" frictionloss="0.4" damping="0.1"/>
<geom name="part_lid" type="box" pos="0.1 0 0" size="0.1 0.1 0.002" density="3125"/></body></worldbody></mujoco>"""
DRAWER = LID.replace('name="object_joint"', 'name="object_joint" type="slide"').replace(
    'axis="0 -1 0"', 'axis="1 0 0"'
)


def belief(tmp_path, xml: str, joint_type: str, axis: tuple[float, float, float]) -> Belief:
    path = tmp_path / "object.xml"
    path.write_text(xml)
    motion = JointMotion(joint_type, np.zeros(3), np.array(axis), 0.0)
    template = PartTemplate(np.zeros((1, 3)), np.ones((1, 3)), motion)
    return Belief(None, SimpleNamespace(mjcf_path=path, range=(-1.0, 1.0)), template, path, path, {})


def touch(effort: np.ndarray, s: np.ndarray) -> Touch:
    t = np.linspace(0.0, 1.0, len(s))
    return Touch(t, s, np.gradient(s, t), effort, np.full(len(s), 0.02), 0.001)


def joint_of(path) -> tuple[float, float, float]:
    """Friction, damping, mass of the part."""
    model = mujoco.MjModel.from_xml_path(str(path))
    return (
        float(model.dof_frictionloss[0]),
        float(np.atleast_1d(model.dof_damping[0])[0]),
        float(model.body_mass[2]),
    )


def test_a_drawer_is_believed_to_slide_as_it_was_felt_to_also_where_that_is_easier_than_guessed(tmp_path):
    x = np.linspace(0.0, 0.1, 200)
    before = belief(
        tmp_path, DRAWER.replace('frictionloss="0.4"', 'frictionloss="9"'), "prismatic", (1.0, 0.0, 0.0)
    )
    after = with_felt(before, [touch(np.full(200, 3.0), x)], tmp_path / "model-1")
    assert after.felt is not None
    for side in (True, False):
        friction, damping, _ = joint_of(after.path(side))
        assert friction + 0.1 * damping == pytest.approx(3.0, abs=0.1)


def test_a_lids_friction_holds_it_whatever_was_felt(tmp_path):
    """Pushed downwards the weight helps: little is felt, and yet the lid stays where it is left."""
    x = np.linspace(0.6, -0.2, 200)
    weight = 0.5 * 9.81 * 0.1 * np.cos(x)
    before = belief(tmp_path, LID, "revolute", (0.0, -1.0, 0.0))
    after = with_felt(before, [touch(weight - 0.52, x)], tmp_path / "model-1")
    friction, _, mass = joint_of(after.path(True))
    assert after.felt is not None
    assert after.felt.friction < 0.61
    assert friction == pytest.approx(HOLDING * mass * 9.81 * 0.1, rel=0.01)


def test_feeling_twice_counts_the_mass_once(tmp_path):
    x = np.linspace(-0.2, 1.0, 400)
    t = np.linspace(0.0, 1.0, 400)
    speed = np.gradient(x, t)
    effort = 1.6 * 0.5 * 9.81 * 0.1 * np.cos(x) + 1.2 + 0.0 * speed
    before = belief(tmp_path, LID, "revolute", (0.0, -1.0, 0.0))
    once = with_felt(before, [touch(effort, x)], tmp_path / "model-1")
    twice = with_felt(once, [touch(effort, x), touch(effort, x)], tmp_path / "model-2")
    assert 0.53 < joint_of(once.path(True))[2] < 0.85  # a prior holds it back
    assert joint_of(twice.path(True))[2] == pytest.approx(0.5 * twice.felt.mass_share, rel=1e-3)


def test_without_a_touch_nothing_changes(tmp_path):
    before = belief(tmp_path, LID, "revolute", (0.0, -1.0, 0.0))
    assert with_felt(before, [], tmp_path / "model-1") is before


def test_without_recordings_nothing_is_felt(tmp_path):
    before = belief(tmp_path, LID, "revolute", (0.0, -1.0, 0.0))
    pushed = SimpleNamespace(free_from=1.0, recording=None, seq=1, label="push 1")
    feeling = Feeling(SimpleNamespace(arm=None), tmp_path / "object-log")
    assert feeling.feel(before, [pushed], pushed, 0.0, 0.2) == []
    assert not (tmp_path / "object-log").exists()


def felt_by(monkeypatch, found):
    """Recordings are their names, an arm is known from them, and ``found`` stands for the search for touches."""
    monkeypatch.setattr(
        feeling_module,
        "samples_in",
        lambda recording: SimpleNamespace(name=recording, part=lambda rows: recording),
    )
    monkeypatch.setattr(feeling_module, "learn_own_torques", lambda arm, free: "arm")
    monkeypatch.setattr(feeling_module, "touches", found)
    monkeypatch.setattr(feeling_module, "free_rows", lambda arm, samples, part, s: 1)


def test_earlier_pushes_are_felt_anew_with_the_arm_known_by_then(tmp_path, monkeypatch):
    """Two touches at first, one when the arm is known better: the second recording of it is gone, too."""
    x, calls = np.linspace(0.0, 0.1, 200), []

    def found(own, arm, samples, part, s_start, s_end, most):
        calls.append((samples.name, s_end))
        return [touch(np.full(200, 3.0), x)] * (2 if len(calls) == 1 else 1)

    felt_by(monkeypatch, found)
    before = belief(tmp_path, DRAWER, "prismatic", (1.0, 0.0, 0.0))
    feeling = Feeling(SimpleNamespace(arm=None), tmp_path / "object-log")
    first = SimpleNamespace(free_from=1.0, recording="one", seq=1, label="push 1")
    second = SimpleNamespace(free_from=1.0, recording="two", seq=2, label="manipulation 1")
    assert len(feeling.feel(before, [first], first, 0.0, 0.1)) == 2
    assert len(feeling.feel(before, [first, second], second, 0.1, 0.2)) == 1
    assert calls == [("one", 0.1), ("one", 0.1), ("two", 0.2)]
    names = sorted(path.name for path in (tmp_path / "object-log").glob("*.csv"))
    assert names == ["manipulation-1-1.csv", "push-1-1.csv"]
    assert len(feeling.touched) == 2


def test_pushes_that_the_other_joint_tells_are_felt_anew_in_it(tmp_path, monkeypatch):
    calls, x = [], np.linspace(0.0, 0.1, 200)

    def found(own, arm, samples, part, s_start, s_end, most):
        calls.append((samples.name, s_start, s_end))
        return [touch(np.full(200, 3.0), x)]

    felt_by(monkeypatch, found)
    lid = belief(tmp_path, LID, "revolute", (0.0, 1.0, 0.0))
    feeling = Feeling(SimpleNamespace(arm=None), tmp_path / "object-log")
    push, one, two = (
        SimpleNamespace(free_from=1.0, recording=name, seq=k, label=f"{name} 1")
        for k, name in enumerate(("push", "one", "two"))
    )
    feeling.feel(lid, [push], push, 0.0, 0.2)
    feeling.feel(lid, [push, one], one, 0.2, 0.5)
    calls.clear()
    feeling.tell_anew(lid, {"one 1": (0.1, 0.4)})
    assert not list((tmp_path / "object-log").glob("*.csv"))
    feeling.feel(lid, [push, one, two], two, 0.4, 0.1)
    assert calls == [("one", 0.1, 0.4), ("two", 0.4, 0.1)]
    assert sorted(feeling.by_motion) == ["one 1", "two 1"]


def test_recordings_of_a_joint_that_was_told_anew_are_gone(tmp_path):
    """They count from another place about another hinge: with those that follow they are no recordings of one joint."""
    push = SimpleNamespace()
    feeling = Feeling(SimpleNamespace(arm=None), tmp_path / "object-log", _pushes={"push 1": push})
    x = np.linspace(0.0, 0.1, 200)
    for name in ("push-1", "push-12"):
        write_log([touch(np.full(200, 3.0), x)], "object_joint", feeling.folder, name, "run", hinged=True)
    feeling.tell_anew(belief(tmp_path, LID, "revolute", (0.0, 1.0, 0.0)), {})
    assert sorted(path.name for path in feeling.folder.iterdir()) == ["push-12-1.csv", "push-12-1.yaml"]
    assert not feeling.touched


def test_what_was_felt_is_drawn_beside_what_was_learnt(tmp_path):
    x = np.linspace(0.0, 0.1, 200)
    after = with_felt(
        belief(tmp_path, DRAWER, "prismatic", (1.0, 0.0, 0.0)),
        [touch(np.full(200, 3.0), x)],
        tmp_path / "model-1",
    )
    figure = felt_figure({"push 1": [touch(np.full(200, 3.0), x)], "manipulation 1": []}, after, DRAWER_TASK)
    over_s, over_t = figure.axes
    measured, model = (line.get_ydata() for line in over_s.lines[:2])
    assert measured == pytest.approx(3.0)
    assert np.median(model) == pytest.approx(3.0, abs=0.1)
    assert over_t.get_xlabel().startswith("time in contact")
