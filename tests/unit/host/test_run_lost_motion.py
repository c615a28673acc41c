"""Lost motion: where motions left the part moves the surface that they pushed, all of them counted alike."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from s2r_host.planning.task import PlanRequest
from s2r_host.report.page import write_report
from s2r_host.run import lost_motion
from s2r_host.run.belief import Belief
from s2r_host.run.contact import Touched
from s2r_host.run.end import End
from s2r_host.run.journal import Journal
from s2r_host.run.lost_motion import LostMotion, learn_lost_motion, tells
from s2r_host.run.manipulate import DoneManipulation
from s2r_host.run.physics import SLOWLY
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.run_json import as_json
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import DRAWER, FAUCET, LAPTOP, Task
from s2r_protocol.exits import UsageError

HALF = 0.1
PUSHED = 0.1  # from the axis
NEARLY = 0.05  # of an offset: one motion is not all the truth, see run/side.py
OBJECT = """<mujoco>
  <worldbody><body name="object_base"><geom name="base_a" type="box" size=".1 .1 .1"/>
    <body name="object_part"><joint name="object_joint" type="{kind}" axis="{axis}" range="-2 2"
      frictionloss="4" damping="5"/>
      <geom name="part_front" type="box" size=".1 .1 .02" quat="1 0 0 0" density="1000"/>
      <geom name="part_handle" type="box" size=".1 .1 .02" quat="1 0 0 0" density="1000"/></body>
  </body></worldbody>
</mujoco>"""


def _done(
    task: Task, foreseen: float, measured: float, s_initial: float, geom="part_front", sigma=0.0, **more: Any
) -> Any:
    """A motion that the object as built would have left at ``foreseen``, and that left the part at ``measured``."""
    grows = foreseen > s_initial
    request = PlanRequest(None, "unused", s_initial, foreseen, np.zeros(7))  # type: ignore[arg-type]
    trajectory = SimpleNamespace(built=foreseen, geom=geom, grows=grows)
    planned = SimpleNamespace(
        foreseen=foreseen, end=End(geom, np.array([PUSHED, 0.0, 0.0]), 0.0, touching=False), number=1,
        request=request, stopped=False, corrected=False, pace=1.0, delivery=SimpleNamespace(trajectory=trajectory),
    )  # fmt: skip
    for name, value in more.items():
        setattr(planned, name, value)
    look = SimpleNamespace(s=measured, sigma=sigma)
    return DoneManipulation(planned, (), None, look, s_initial, foreseen)  # type: ignore[arg-type]


def _played(trajectory: Any, request: PlanRequest) -> Any:
    """The fingertip stops at a place: the part is as much further on as the surface pushed lies further back."""
    model = mujoco.MjModel.from_xml_path(str(request.object_mjcf))
    geom = model.geom(trajectory.geom)
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
        side = -1.0 if trajectory.grows else 1.0
        moved = geom.pos[0] + side * geom.size[0] - side * HALF
    else:
        at = trajectory.at if hasattr(trajectory, "at") else np.array([PUSHED, 0.0, 0.0])
        x, y, _ = geom.pos + Rotation.from_quat(geom.quat, scalar_first=True).apply(at)
        moved = np.arctan2(y, x) - np.arctan2(at[1], at[0])
    return SimpleNamespace(final=trajectory.built - moved)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """``run(task, *motions)``: session and record of a run that made these motions."""
    monkeypatch.setattr(lost_motion, "replay", _played)

    def made(task: Task, *motions: Any) -> tuple[Any, RunRecord]:
        slides = task.joint_type == "prismatic"
        path = tmp_path / "object.xml"
        path.write_text(
            OBJECT.format(kind="slide" if slides else "hinge", axis="1 0 0" if slides else "0 0 1")
        )
        settings = RunSettings(0.05, tmp_path / "run", task=task, learn_physics=True)
        record = RunRecord(settings, Journal())
        about_z = np.eye(4)

        def pose(s: float) -> np.ndarray:
            about_z[:2, :2] = [[np.cos(s), -np.sin(s)], [np.sin(s), np.cos(s)]]
            return about_z

        template = SimpleNamespace(
            slides=slides, axis=np.array([1.0, 0.0, 0.0]), pose=pose, p=np.array([[PUSHED, 0.0, 0.0]]),
            velocity=lambda p: np.cross([0.0, 0.0, 1.0], p),
        )  # fmt: skip
        estimate = SimpleNamespace(delta=0.4, lever=None, intervals90=SimpleNamespace(axis_offset_m=0.0))
        record.belief = Belief(estimate, None, template, path, path, {})  # type: ignore[arg-type]
        record.goals += [Goal(one.s_target, [one]) for one in motions]
        return SimpleNamespace(settings=settings, journal=record.journal), record

    return made


def _again(record: RunRecord, done: Any) -> float:
    assert record.belief is not None
    request = SimpleNamespace(object_mjcf=record.belief.path(done.s_target > done.s_initial))
    return _played(done.planned.delivery.trajectory, request).final  # type: ignore[arg-type]


@pytest.mark.parametrize(("task", "unit"), [(DRAWER, 1.0), (FAUCET, 10.0)])
def test_each_direction_is_foreseen_where_its_motions_left_the_part(run, task, unit):
    out = _done(task, 0.1 * unit, 0.097 * unit, 0.0)
    back = _done(task, 0.0, -0.002 * unit, 0.1 * unit)
    session, record = run(task, out, back, out, back)
    learn_lost_motion(session, record)
    assert _again(record, out) == pytest.approx(out.measured.s, abs=0.003 * unit * NEARLY)
    assert _again(record, back) == pytest.approx(back.measured.s, abs=0.002 * unit * NEARLY)
    (lesson,) = record.lost_motion
    assert lesson.found == {
        "part_front, growing": pytest.approx(0.003 * unit, rel=NEARLY),
        "part_front, falling": pytest.approx(-0.002 * unit, rel=NEARLY),  # it went further
    }


def test_what_is_known_is_not_learnt_twice(run):
    session, record = run(DRAWER, _done(DRAWER, 0.1, 0.097, 0.0))
    learn_lost_motion(session, record)
    before = record.belief
    learn_lost_motion(session, record)
    assert record.belief is before
    assert len(record.lost_motion) == 1


def test_an_object_modelled_anew_knows_of_no_lesson(run):
    """Where the joint is told again the model is built again, with its sides where they were seen."""
    out = _done(FAUCET, 0.4, 0.42, 0.0)
    session, record = run(FAUCET, out, out)
    built = record.belief
    learn_lost_motion(session, record)
    record.belief = built
    learn_lost_motion(session, record)
    assert _again(record, out) == pytest.approx(0.42, abs=0.02 * NEARLY)


def test_one_motion_that_went_another_way_does_not_shift_the_rest(run):
    ends = (0.098, 0.0981, 0.0945)
    motions = [_done(DRAWER, 0.1, end, 0.0) for end in ends]
    session, record = run(DRAWER, *motions)
    learn_lost_motion(session, record)
    assert _again(record, motions[0]) == pytest.approx(0.098, abs=0.002 * NEARLY)


def test_one_motion_teaches_half_of_what_it_tells_and_a_second_one_that_agrees_all(run):
    out = _done(DRAWER, 0.1, 0.098, 0.0)
    session, record = run(DRAWER, out)
    learn_lost_motion(session, record)
    assert _again(record, out) == pytest.approx(0.099, abs=0.002 * NEARLY)
    record.goals.append(Goal(out.s_target, [out]))
    learn_lost_motion(session, record)
    assert _again(record, out) == pytest.approx(0.098, abs=0.002 * NEARLY)


def test_what_the_camera_hardly_sees_is_believed_in_part_and_not_more_with_every_target(run):
    """A lid edge-on is known no better than motions of lids repeat: a third of the offset, target after target."""
    motion = _done(LAPTOP, 0.5, 0.48, 0.0, sigma=LAPTOP.beside)
    session, record = run(LAPTOP, motion)
    learn_lost_motion(session, record)
    third = 0.5 - 0.02 / 3.0
    assert _again(record, motion) == pytest.approx(third, abs=0.02 * NEARLY)
    learn_lost_motion(session, record)
    assert _again(record, motion) == pytest.approx(third, abs=0.02 * NEARLY)


def test_what_looks_have_alike_is_believed_by_half_however_vague_the_hinge(run):
    """Five motions end 4° short; a hinge told to 50 mm could make all of that in the looks, and 30° as well."""
    short = np.radians(4.0)
    motions = [_done(FAUCET, 0.9, 0.9 - short, 0.0) for _ in range(5)]
    session, record = run(FAUCET, *motions)
    assert record.belief is not None
    record.belief.estimate.intervals90.axis_offset_m = 0.05
    learn_lost_motion(session, record)
    learnt = 0.9 - _again(record, motions[0])
    assert 0.4 * short < learnt < 0.6 * short


def test_a_side_that_lies_further_back_is_known_for_pushes_elsewhere_too(run):
    """2 mm too far back: 1.1° beside at 100 mm from the axis, 2.3° where the lever is pushed at 50 mm."""
    back_m, places = 0.002, (0.1, 0.07, 0.05)
    motions = []
    for place in places:
        at = np.array([place, 0.0, 0.0])
        motion = _done(FAUCET, 0.4, 0.4 + np.arctan2(back_m, place), 0.0)
        motion.planned.end = End("part_front", at, 0.0, touching=False)
        motion.planned.delivery.trajectory.at = at
        motions.append(motion)
    session, record = run(FAUCET, *motions[:2])
    learn_lost_motion(session, record)
    assert _again(record, motions[2]) == pytest.approx(motions[2].measured.s, abs=0.2 * back_m / places[2])


def test_of_a_slide_each_surface_is_learnt_apart(run):
    front, handle = _done(DRAWER, 0.1, 0.098, 0.0), _done(DRAWER, 0.1, 0.104, 0.0, "part_handle")
    session, record = run(DRAWER, front, handle, front, handle)
    learn_lost_motion(session, record)
    assert _again(record, front) == pytest.approx(0.098, abs=0.002 * NEARLY)
    assert _again(record, handle) == pytest.approx(0.104, abs=0.004 * NEARLY)


def test_what_was_told_of_the_joint_since_counts_for_earlier_motions(run, monkeypatch):
    """Half of the way lost was friction: with that learnt the surface is moved by the other half."""
    out = _done(DRAWER, 0.1, 0.096, 0.0)
    session, record = run(DRAWER, out, out)
    learn_lost_motion(session, record)
    monkeypatch.setattr(
        lost_motion, "replay", lambda t, r: SimpleNamespace(final=_played(t, r).final - 0.002)
    )
    learn_lost_motion(session, record)
    assert [lesson.found["part_front, growing"] for lesson in record.lost_motion] == [
        pytest.approx(0.004, rel=NEARLY),
        pytest.approx(-0.002, rel=NEARLY),
    ]


def test_where_the_fingertip_pushed_to_the_end_geometry_says_where_the_part_was_left(run, monkeypatch):
    """No replay: what the joint resists with does not count."""
    out = _done(FAUCET, 0.4, 0.42, 0.0)
    out.planned.end = End("part_front", np.array([PUSHED, 0.0, 0.0]), 0.0, touching=True)
    out.planned.delivery.trajectory.q = np.zeros((2, 7))

    def touched(path, arm, q_end, s, positive, most):
        request = SimpleNamespace(object_mjcf=path)
        return Touched(_played(out.planned.delivery.trajectory, request).final, "part_front", np.zeros(3))  # type: ignore[arg-type]

    monkeypatch.setattr(lost_motion, "touch_at", touched)
    monkeypatch.setattr(lost_motion, "replay", None)
    session, record = run(FAUCET, out, out)
    session.arm = None
    learn_lost_motion(session, record)
    assert _again(record, out) == pytest.approx(0.42, abs=0.02 * NEARLY)


def test_a_surface_that_does_not_decide_where_motions_end_stays(run, monkeypatch):
    """Or it would be moved on and on, target after target."""
    session, record = run(DRAWER, _done(DRAWER, 0.1, 0.097, 0.0))
    monkeypatch.setattr(lost_motion, "replay", lambda t, r: SimpleNamespace(final=t.built))
    before = record.belief
    learn_lost_motion(session, record)
    assert record.belief is before
    assert record.lost_motion == []


def test_a_surface_that_no_motion_would_meet_once_moved_stays(run, monkeypatch):
    """Nothing would be left to tell whether that is where it is."""
    session, record = run(DRAWER, _done(DRAWER, 0.1, 0.097, 0.0))
    before = record.belief
    built = before.path(True)

    def replayed(trajectory, request):
        far = 0.0 if request.object_mjcf == built else 0.02
        return SimpleNamespace(final=_played(trajectory, request).final + far)

    monkeypatch.setattr(lost_motion, "replay", replayed)
    learn_lost_motion(session, record)
    assert record.belief is before
    assert record.lost_motion == []


def test_a_motion_that_by_now_would_have_ended_far_off_does_not_count(run, monkeypatch):
    """With what was learnt of the joint since, it went another way."""
    motions = [_done(DRAWER, 0.1, end, 0.0) for end in (0.099, 0.098, 0.098)]
    astray = motions[0].planned.delivery.trajectory

    def replayed(trajectory, request):
        far = 0.02 if trajectory is astray else 0.0
        return SimpleNamespace(final=_played(trajectory, request).final + far)

    monkeypatch.setattr(lost_motion, "replay", replayed)
    session, record = run(DRAWER, *motions)
    learn_lost_motion(session, record)
    assert _again(record, motions[1]) == pytest.approx(0.098, abs=0.002 * NEARLY)


def test_motions_that_say_nothing_teach_nothing(run):
    stopped = _done(DRAWER, 0.1, 0.097, 0.0, stopped=True)
    slipped = _done(DRAWER, 0.1, 0.08, 0.0)
    session, record = run(DRAWER, stopped, slipped)
    learn_lost_motion(session, record)
    assert record.lost_motion == []
    untaught = RunSettings(0.05, session.settings.out, learn_physics=True, without=("touch",))
    session, record = run(DRAWER, _done(DRAWER, 0.1, 0.097, 0.0))
    session.settings = untaught
    learn_lost_motion(session, record)
    assert record.lost_motion == []


def test_leaving_out_what_is_not_asked_for_is_refused(tmp_path):
    assert RunSettings(0.05, tmp_path / "run", learn_physics=True, without=("gap",)).without == ("gap",)
    with pytest.raises(UsageError, match="--without gap leaves out a part of --learn-physics"):
        RunSettings(0.05, tmp_path / "run", without=("gap",))


def test_which_motions_say_where_the_surface_is():
    assert tells(_done(DRAWER, 0.1, 0.097, 0.0), DRAWER)
    assert not tells(_done(DRAWER, 0.1, 0.097, 0.0, stopped=True), DRAWER)
    assert not tells(_done(DRAWER, 0.1, 0.097, 0.0, corrected=True), DRAWER)
    assert not tells(_done(DRAWER, 0.1, 0.08, 0.0), DRAWER)
    assert not tells(_done(DRAWER, 0.1, 0.099, 0.097), DRAWER)  # a correction
    assert tells(_done(FAUCET, 0.2, 0.24, 0.0), FAUCET)
    assert not tells(
        _done(FAUCET, 0.2, 0.26, 0.0), FAUCET
    )  # into the next notch: more than a quarter of the way
    assert tells(_done(DRAWER, 0.1, 0.097, 0.0, pace=SLOWLY), DRAWER)
    assert not tells(_done(FAUCET, 0.4, 0.39, 0.0, pace=SLOWLY), FAUCET)  # it coasts less than the usual ones


def test_the_report_and_run_json_tell_what_was_lost(tmp_path):
    record = RunRecord(RunSettings(0.1, tmp_path / "run", learn_physics=True), Journal())
    record.lost_motion.append(
        LostMotion(2, {"part_handle_bar, growing": -0.003}, {"part_handle_bar, growing": np.array([-0.003])})
    )
    assert (
        "-3.00 mm at part_handle_bar, growing" in write_report(record, tmp_path / "report.html").read_text()
    )
    assert as_json(record)["lost_motion"] == [
        {
            "after_manipulations": 2,
            "surfaces": {"part_handle_bar, growing": -0.003},
            "moved": {"part_handle_bar, growing": [-0.003]},
        }
    ]
