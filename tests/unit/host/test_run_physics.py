"""Physics learnt between targets: what the gap tool names is what brakes the part in the next plans."""

import csv
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from s2r_host.gap.config import GapConfig
from s2r_host.gap.pipeline import analyse
from s2r_host.model.belief import prior
from s2r_host.planning.doubt import Doubt
from s2r_host.proprioception.following import _unbroken
from s2r_host.proprioception.object_numbers import ObjectNumbers
from s2r_host.report.page import write_report
from s2r_host.run import reach
from s2r_host.run.belief import Belief
from s2r_host.run.doubts import doubt_about
from s2r_host.run.journal import Journal
from s2r_host.run.manipulate import DoneManipulation
from s2r_host.run.object_file import with_friction
from s2r_host.run.physics import (
    SLOW_RAD_S,
    SLOWEST,
    SLOWLY,
    JointLaw,
    PhysicsLesson,
    _hurry,
    _with_law,
    before_target,
    pace,
)
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.run_json import as_json
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import LAPTOP

FRICTION, SWING, PERIOD = 4.0, 1.5, 0.05
OBJECT = """<mujoco>
  <worldbody><body name="object_base"><geom name="base_a" type="box" size=".1 .1 .1"/>
    <body name="object_part"><joint name="object_joint" type="slide" axis="1 0 0" range="-.2 .2"
      frictionloss="4" damping="5"/><geom name="part_a" type="box" size=".1 .1 .02" density="1000"/></body>
  </body></worldbody>
</mujoco>"""


def _friction(s):
    return FRICTION + SWING * np.sin(2.0 * np.pi * s / PERIOD)


def _stroke(path: Path, start: float, end: float, rng) -> Path:
    """One push from rest to rest, as the object log has it: effort with the gauge's noise."""
    t = np.arange(0.0, 2.0, 0.005)
    x = np.clip((t - 0.1) / 1.8, 0.0, 1.0)
    s = start + (end - start) * (10 * x**3 - 15 * x**4 + 6 * x**5)
    ds = np.gradient(s, t)
    dds = np.gradient(ds, t)
    effort = np.sign(end - start) * _friction(s) + 5.0 * ds + 0.8 * dds
    effort += np.convolve(rng.normal(0.0, 0.3, len(t)), np.ones(10) / 10.0, "same")
    rows = slice(30, -30)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "q.object_joint", "dq.object_joint", "tau.object_joint"])
        writer.writerows(np.column_stack([t, s, ds, effort])[rows].tolist())
    side = {
        "effort": "measured",
        "effort_sigma": {"object_joint": 0.3},
        "input": "effort",
        "session": path.stem,
    }
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side))
    return path


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """A joint law from three strokes, out, in and out again, of a drawer whose friction changes along the way."""
    folder = tmp_path_factory.mktemp("physics")
    model = folder / "object.xml"
    model.write_text(OBJECT)
    rng = np.random.default_rng(4)
    ways = ((-0.04, 0.04), (0.04, -0.035), (-0.035, 0.035))
    logs = [_stroke(folder / f"manipulation-{k}-1.csv", *way, rng) for k, way in enumerate(ways, start=1)]
    config = GapConfig(simulate=False, baselines=False, next_experiment=False)
    analysis = analyse(model, logs, [], [], config, lambda _text: None)
    assert analysis.twin is not None
    return SimpleNamespace(
        analysis=analysis,
        law=JointLaw(analysis.twin.model, analysis.twin, analysis.twin.rigid.model),
        model=model,
    )


def test_friction_along_the_way_is_named_from_three_strokes(learnt):
    effects = learnt.analysis.decision.effects
    assert [effect.name for effect in effects] == ["cogging"]


@pytest.mark.parametrize("target", [-0.02, 0.0, 0.02])
@pytest.mark.parametrize("positive", [True, False])
def test_a_part_is_braked_by_the_friction_where_the_motion_ends(learnt, target, positive):
    sign = 1.0 if positive else -1.0
    true = float(np.mean(_friction(np.linspace(target - sign * 0.015, target, 9))))
    assert learnt.law.braking(target, positive, slides=True) == pytest.approx(true, rel=0.12)


def test_friction_alone_pulls_nowhere(learnt):
    pull, dry = learnt.law.pull(0.01, slides=True)
    assert abs(pull) < 0.15 * dry


def test_the_law_is_written_as_stock_attributes(learnt, tmp_path):
    model = mujoco.MjModel.from_xml_path(str(_with_law(learnt.model, learnt.law, 2.5, tmp_path / "new.xml")))
    assert model.dof_frictionloss[0] == pytest.approx(2.5)
    assert model.dof_damping[0] == pytest.approx(learnt.law.damping)
    mass = mujoco.MjModel.from_xml_path(str(learnt.model)).body("object_part").mass
    assert model.body("object_part").mass == pytest.approx(mass)


def test_a_spring_that_a_later_lesson_does_not_find_any_more_is_gone(learnt, tmp_path):
    spec = mujoco.MjSpec.from_file(str(learnt.model))
    spec.joint("object_joint").stiffness, spec.joint("object_joint").springref = [60.0, 0, 0], 0.1
    rigid = SimpleNamespace(model=mujoco.MjModel.from_xml_path(str(learnt.model)))
    sprung = JointLaw(spec.compile(), SimpleNamespace(live=[], ctx=None, rigid=rigid), rigid.model)  # pyright: ignore[reportArgumentType]
    first = _with_law(learnt.model, sprung, 2.5, tmp_path / "first.xml")
    assert mujoco.MjModel.from_xml_path(str(first)).jnt_stiffness.ravel()[0] == pytest.approx(60.0)
    second = _with_law(first, learnt.law, 2.5, tmp_path / "second.xml")
    assert mujoco.MjModel.from_xml_path(str(second)).jnt_stiffness.ravel()[0] == 0.0


def test_a_spring_that_is_stronger_than_friction_is_told_from_one_that_is_not(learnt):
    spec = mujoco.MjSpec.from_file(str(learnt.model))
    spec.joint("object_joint").stiffness, spec.joint("object_joint").springref = [60.0, 0, 0], 0.0
    rigid = SimpleNamespace(model=mujoco.MjModel.from_xml_path(str(learnt.model)))
    sprung = JointLaw(spec.compile(), SimpleNamespace(live=[], ctx=None, rigid=rigid), rigid.model)
    assert sprung.pull(0.05, slides=True) == (pytest.approx(-3.0), pytest.approx(4.0))
    pull, dry = sprung.pull(0.08, slides=True)
    assert abs(pull) > dry


def test_a_tilt_that_was_found_pulls_and_brakes_one_way_more_than_the_other(learnt):
    spec = mujoco.MjSpec.from_file(str(learnt.model))
    spec.option.gravity = [-2.0, 0.0, -9.6]
    rigid = SimpleNamespace(model=mujoco.MjModel.from_xml_path(str(learnt.model)))
    tilted = JointLaw(spec.compile(), SimpleNamespace(live=[], ctx=None, rigid=rigid), rigid.model)
    weight = 2.0 * float(rigid.model.body("object_part").mass[0])
    assert tilted.pull(0.0, slides=True)[0] == pytest.approx(-weight)
    assert tilted.braking(0.0, True, slides=True) == pytest.approx(4.0 + weight)
    assert tilted.braking(0.0, False, slides=True) == pytest.approx(4.0 - weight)


def _hinge(axis, friction, mass=2.0):
    """A plate of 0.3 m about a hinge at its edge, level at 0: a lid where the axis is level, else a faucet's lever."""
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/><worldbody><body name="object_base">
        <geom name="base_a" type="box" size=".1 .1 .1" pos="0 0 -1"/>
        <body name="object_part"><joint name="object_joint" type="hinge" axis="{axis}" range="-3 3"
          frictionloss="{friction}" damping="0.05"/>
        <geom name="part_a" type="box" size=".15 .1 .005" pos="-.15 0 0" mass="{mass}"/></body></body></worldbody>
        </mujoco>"""
    )


def _hinge_law(axis, friction):
    """A hinge that holds its part everywhere, as plans know it, of which less friction was found."""
    rigid: Any = SimpleNamespace(model=_hinge(axis, 4.0))
    twin: Any = SimpleNamespace(live=[], ctx=None, rigid=rigid)
    return JointLaw(_hinge(axis, friction), twin, rigid.model)


def _moves_by_itself(model, s):
    """How far in a second, let go at rest [rad]."""
    data = mujoco.MjData(model)
    data.qpos[0] = s
    for _ in range(int(1.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return abs(float(data.qpos[0]) - s)


@pytest.mark.parametrize("s", [0.1, 0.5, 0.9, 1.2, 1.5])
@pytest.mark.parametrize("friction", [0.6, 1.5])
def test_a_lid_that_less_friction_no_longer_holds_is_pulled_by_its_own_weight(friction, s):
    law = _hinge_law("0 1 0", friction)
    pull, dry = law.pull(s, slides=False)
    assert pull == pytest.approx(-2.0 * 9.81 * 0.15 * np.cos(s))
    assert dry == pytest.approx(friction)
    assert (abs(pull) > dry) == (_moves_by_itself(law.model, s) > 0.1)


def test_gravity_pulls_neither_a_lever_that_turns_about_the_vertical_nor_a_drawer(learnt):
    assert _hinge_law("0 0 1", 0.3).pull(0.5, slides=False) == (pytest.approx(0.0), pytest.approx(0.3))
    spec = mujoco.MjSpec.from_file(str(learnt.model))
    spec.option.gravity = [-0.2, 0.0, -9.8]  # an axis that was seen 1.2 degrees off
    model = spec.compile()
    twin: Any = SimpleNamespace(live=[], ctx=None, rigid=None)
    assert JointLaw(model, twin, model).pull(0.01, slides=True) == (pytest.approx(0.0), pytest.approx(4.0))


def test_a_lid_that_will_fall_is_warned_of(learnt, tmp_path):
    settings = RunSettings(0.1, tmp_path / "run", task=LAPTOP, learn_physics=True)
    session: Any = SimpleNamespace(settings=settings, target=0.5, journal=Journal())
    lid = tmp_path / "lid.xml"
    mujoco.mj_saveLastXML(str(lid), _hinge("0 1 0", 4.0))
    record = RunRecord(settings, Journal())
    record.belief = replace(_believed(lid), template=SimpleNamespace(slides=False))  # pyright: ignore[reportArgumentType]
    record.lessons.append(PhysicsLesson(3, tmp_path, "parameter_off", law=_hinge_law("0 1 0", 1.5)))
    before_target(session, record)
    assert "pulled with -2.58 against a dry friction of 1.50" in session.journal.warnings[0]


def test_a_fingertip_that_seems_to_jump_is_believed_in_one_place_only():
    s = np.concatenate([[0.218, 0.214], 0.01 + 0.0005 * np.arange(50), [0.3]])
    assert _unbroken(s, 0.005).tolist() == list(range(2, 52))
    assert len(_unbroken(s[2:52], 0.005)) == 50


def test_the_report_and_run_json_tell_what_was_learnt(tmp_path):
    record = RunRecord(RunSettings(0.1, tmp_path / "run", learn_physics=True), Journal())
    cogging = {"name": "cogging", "probability": 0.98}
    number = {"name": "frictionloss", "joint": "object_joint", "from": 5.66, "to": 5.26, "unit": "N"}
    lesson = PhysicsLesson(
        3, tmp_path / "run/physics-3", "physics_missing", (cogging,), (number,), ("cogging",), (),
    )  # fmt: skip
    record.lessons.append(lesson)
    text = write_report(record, tmp_path / "report.html").read_text()
    assert "cogging (98 %), frictionloss: 5.66 → 5.26 N" in text
    said = as_json(record)["physics"][0]
    assert (said["verdict"], said["after_manipulations"], said["carried"]) == (
        "physics_missing",
        3,
        ["cogging"],
    )


def _believed(model: Path) -> Any:
    intervals = SimpleNamespace(delta=(-0.001, 0.001), axis_angle_rad=0.01, axis_offset_m=0.0)
    return Belief(
        estimate=SimpleNamespace(intervals90=intervals),  # pyright: ignore[reportArgumentType]
        model=SimpleNamespace(physics=prior("prismatic")),  # pyright: ignore[reportArgumentType]
        template=SimpleNamespace(slides=True),  # pyright: ignore[reportArgumentType]
        falling=model,
        growing=model,
        shifts={},
        felt=ObjectNumbers(1.0, 4.0, 5.0, 0.0, (0.1, 0.1, 0.1), 0.1, 4.0),
    )


def test_the_next_plans_and_their_ensemble_know_what_was_learnt(learnt, tmp_path):
    settings = RunSettings(0.1, tmp_path / "run", learn_physics=True)
    session: Any = SimpleNamespace(settings=settings, target=0.0125, journal=Journal())
    record = RunRecord(settings, Journal())
    record.belief = _believed(learnt.model)
    before_target(session, record)
    assert record.belief.growing == learnt.model  # nothing learnt, nothing changed
    record.lessons.append(PhysicsLesson(3, tmp_path, "physics_missing", law=learnt.law, noise=0.2))
    before_target(session, record)
    for positive in (True, False):
        model = mujoco.MjModel.from_xml_path(str(record.belief.path(positive)))
        assert model.dof_frictionloss[0] == pytest.approx(
            learnt.law.braking(0.0125, positive, slides=True), rel=1e-4
        )
    doubt = doubt_about(record.belief, growing=True)
    low, high = doubt.joint_friction
    assert 0.8 < low < 1.0 < high < 1.2
    assert doubt.damping == Doubt().damping  # it was felt: the builder's guess counts no more
    assert not session.journal.warnings


def test_a_correction_is_braked_as_the_lesson_says_too(learnt, tmp_path, monkeypatch):
    """What the arm felt of the manipulation before it is one friction for the whole way."""
    settings = RunSettings(0.1, tmp_path / "run", learn_physics=True, attempts=2)
    session: Any = SimpleNamespace(
        settings=settings,
        target=0.0125,
        journal=Journal(),
        recorder=SimpleNamespace(add_note=lambda *_: None),
    )
    record = RunRecord(
        settings, Journal(), lessons=[PhysicsLesson(3, tmp_path, "physics_missing", law=learnt.law)]
    )
    record.belief = _believed(learnt.model)
    record.goals.append(Goal(0.0125, s_before=0.0))
    before_target(session, record)
    friction, states = [], iter([0.005, 0.0125])

    def prepared(_session, belief, *_):
        friction.append(float(mujoco.MjModel.from_xml_path(str(belief.growing)).dof_frictionloss[0]))
        return SimpleNamespace(
            result=SimpleNamespace(control_steps=1), foreseen=0.005, corrected=False, stopped=False,
            delivery=SimpleNamespace(trajectory=SimpleNamespace(duration_s=1.0)),
        )  # fmt: skip

    def measured(_session, _record, planned, executed, view, s_now):
        state = SimpleNamespace(s=next(states), sigma=1e-4)
        return DoneManipulation(planned, executed, view, state, s_now, session.target), False  # pyright: ignore[reportArgumentType]

    def felt(_session, _feeling, belief, _executed, _from, _to, folder):
        sides = (
            with_friction(belief.path(side), "object_joint", 9.0, folder / f"{side}.xml")
            for side in (False, True)
        )
        return replace(belief, **dict(zip(("falling", "growing"), sides, strict=True)))

    monkeypatch.setattr(reach, "prepare_manipulation", prepared)
    monkeypatch.setattr(reach, "carry_out_manipulation", lambda _session, planned: (planned, (None,)))
    monkeypatch.setattr(reach, "_measured", measured)
    monkeypatch.setattr(reach, "belief_with_felt", felt)
    monkeypatch.setattr(reach, "tell_again", lambda *_: False)
    nothing: Any = None
    reach.reach(session, record, nothing, nothing, 0.0)
    assert friction == [pytest.approx(learnt.law.braking(0.0125, True, slides=True), rel=1e-4)] * 2


def test_what_is_felt_of_a_part_that_stayed_is_not_believed_of_it(learnt, tmp_path, monkeypatch):
    """The fingertip pressed on something that does not give way."""
    settings, learns = RunSettings(0.1, tmp_path / "run", learn_physics=True, attempts=1), []
    nothing: Any = None

    def left_at(s: float) -> int:
        session: Any = SimpleNamespace(
            settings=settings,
            target=0.1,
            journal=Journal(),
            recorder=SimpleNamespace(add_note=lambda *_: None),
        )
        record = RunRecord(settings, Journal())
        record.belief = _believed(learnt.model)
        record.goals.append(Goal(0.1, s_before=0.0))
        planned = SimpleNamespace(
            result=SimpleNamespace(control_steps=1, p_part=np.zeros(3)), foreseen=0.1, corrected=False,
            stopped=True, delivery=SimpleNamespace(trajectory=SimpleNamespace(duration_s=1.0)),
        )  # fmt: skip
        done = DoneManipulation(planned, (None,), None, SimpleNamespace(s=s, sigma=1e-4), 0.0, 0.1)  # pyright: ignore[reportArgumentType]
        monkeypatch.setattr(reach, "prepare_manipulation", lambda *_: planned)
        monkeypatch.setattr(reach, "carry_out_manipulation", lambda *_: (planned, (None,)))
        monkeypatch.setattr(reach, "_measured", lambda *_: (done, False))
        monkeypatch.setattr(reach, "belief_with_felt", lambda _s, _f, belief, *_: learns.append(s) or belief)
        monkeypatch.setattr(reach, "tell_again", lambda *_: False)
        reach.reach(session, record, nothing, nothing, 0.0)
        return len(learns)

    assert left_at(0.002) == 0
    assert left_at(0.05) == 1  # half the way is a way: it resisted more than was believed


def test_a_part_that_something_pulls_away_is_warned_of_unless_it_stayed_there_before(learnt, tmp_path):
    spec = mujoco.MjSpec.from_file(str(learnt.model))
    spec.joint("object_joint").stiffness, spec.joint("object_joint").springref = [60.0, 0, 0], 0.0
    rigid = SimpleNamespace(model=mujoco.MjModel.from_xml_path(str(learnt.model)))
    law = JointLaw(spec.compile(), SimpleNamespace(live=[], ctx=None, rigid=rigid), rigid.model)  # pyright: ignore[reportArgumentType]
    settings = RunSettings(0.1, tmp_path / "run", learn_physics=True)
    session: Any = SimpleNamespace(settings=settings, target=0.09, journal=Journal())
    record = RunRecord(settings, Journal())
    record.belief = _believed(learnt.model)
    record.lessons.append(PhysicsLesson(3, tmp_path, "physics_missing", law=law))
    before_target(session, record)
    assert "pulled with -5.40 against a dry friction of 4.00" in session.journal.warnings[0]
    record.goals.append(Goal(0.09, [SimpleNamespace(measured=SimpleNamespace(s=0.085))]))  # pyright: ignore[reportArgumentType]
    session.journal = Journal()
    before_target(session, record)
    assert not session.journal.warnings


def test_a_part_stays_in_the_model_where_it_was_seen_at_rest(learnt, tmp_path):
    """Plans are refused where it would not stay; a spring that was named wrongly is no reason for that."""
    spec = mujoco.MjSpec.from_file(str(learnt.model))
    spec.joint("object_joint").stiffness, spec.joint("object_joint").springref = [60.0, 0, 0], 0.0
    rigid = SimpleNamespace(model=mujoco.MjModel.from_xml_path(str(learnt.model)))
    law = JointLaw(spec.compile(), SimpleNamespace(live=[], ctx=None, rigid=rigid), rigid.model)  # pyright: ignore[reportArgumentType]
    session: Any = SimpleNamespace(
        settings=RunSettings(0.1, tmp_path / "run", learn_physics=True), target=0.01, journal=Journal()
    )
    record = RunRecord(session.settings, Journal())
    record.belief = _believed(learnt.model)
    record.lessons.append(PhysicsLesson(3, tmp_path, "physics_missing", law=law))
    friction = []
    for s_before in (0.02, 0.15):
        record.goals.append(Goal(0.01, s_before=s_before))
        before_target(session, record)
        friction.append(float(mujoco.MjModel.from_xml_path(str(record.belief.growing)).dof_frictionloss[0]))
    assert friction[0] == pytest.approx(law.braking(0.01, True, slides=True), rel=1e-4)
    assert friction[1] == pytest.approx(1.05 * 60.0 * 0.15, rel=1e-4)


def test_every_third_motion_is_slow_until_a_lesson_has_told_something(tmp_path):
    assert [pace(number, []) for number in range(1, 6)] == [1.0, 1.0, SLOWLY, 1.0, 1.0]
    open_answers = [PhysicsLesson(3, tmp_path, verdict) for verdict in ("unknown", "insufficient", "refused")]
    assert pace(6, open_answers) == SLOWLY
    told = PhysicsLesson(3, tmp_path, "nothing_missing")
    assert [pace(number, [*open_answers, told]) for number in range(4, 7)] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("fastest", "share"), [(0.75, SLOW_RAD_S / 0.75), (2.0, SLOWEST), (0.1, SLOWLY), (None, SLOWLY)]
)
def test_a_slow_motion_is_as_slow_as_what_sticks_lets_go(fastest, share):
    """By how fast the part was felt to go: a short lever turns faster than a lid at the same fingertip."""
    record: Any = SimpleNamespace(belief=SimpleNamespace(template=SimpleNamespace(slides=False)), felt={})
    if fastest is not None:
        record.felt = {"push 1": [SimpleNamespace(ds=np.array([0.0, -fastest]))], "manipulation 1": []}
    assert pace(3, [], _hurry(record)) == pytest.approx(share)
    assert pace(2, [], _hurry(record)) == 1.0


def test_the_session_moves_the_part_at_the_pace_of_its_target(learnt, tmp_path):
    settings = RunSettings(0.1, tmp_path / "run", learn_physics=True)
    session: Any = SimpleNamespace(settings=settings, target=0.0, journal=Journal(), pace=1.0)
    record = RunRecord(settings, Journal())
    record.belief = _believed(learnt.model)
    record.goals += [Goal(0.1), Goal(0.0), Goal(0.1)]
    before_target(session, record)
    assert session.pace == SLOWLY
    record.lessons.append(PhysicsLesson(3, tmp_path, "physics_missing", law=learnt.law, noise=0.2))
    before_target(session, record)
    assert session.pace == 1.0
