"""A manipulation that moved a lever further than the push tells its hinge anew, if the push told it wrongly."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.motion.scene import observed_scene
from s2r_host.perception import synthetic
from s2r_host.perception.estimate import estimate_joint
from s2r_host.perception.intervals import Intervals
from s2r_host.perception.motion import JointMotion, line_distance
from s2r_host.perception.synthetic import Box, beam, look_at
from s2r_host.run.belief import Belief
from s2r_host.run.manipulate import DoneManipulation
from s2r_host.run.measure import Measurement, part_template
from s2r_host.run.physics import PhysicsLesson, newest_law
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.task import TASKS
from s2r_host.run.tell_again import tell_again, tell_lost

PIVOT, UP = np.array([0.6, 0.0, 0.18]), np.array([0.0, 0.0, 1.0])
K, SHAPE = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]]), (360, 640)
NOT_USED: Any = None
PUSHED_RAD, NOW_RAD, ASKED_RAD = np.radians([15.0, 40.0, 25.0])


def pair(turn_rad: float):
    """A lever of 11 cm on a column before and after a turn."""
    table = np.eye(4)
    table[:3, 3] = (0.7, 0.0, -0.01)
    static = [
        Box(table, np.array([1.2, 1.2, 0.02])),
        beam(np.array([0.6, 0.0, 0.0]), PIVOT - 0.01 * UP, 0.04, 0.04),
    ]
    lever = [beam(PIVOT, PIVOT + np.array([-0.05, -0.1, 0.01]), 0.02, 0.014)]
    camera = look_at(np.array([0.0, -0.35, 0.6]), PIVOT)
    motion = JointMotion("revolute", PIVOT, UP, turn_rad)
    return synthetic.pair(static, lever, motion, K, SHAPE, camera, np.random.default_rng(3))


def look(name: str, frame) -> Any:
    mask = np.zeros(frame.depth_m.shape, bool)
    return SimpleNamespace(
        name=name, capture=SimpleNamespace(frame=frame), arm_mask=mask, scene=observed_scene(frame, mask)
    )


@pytest.fixture(scope="module")
def views():
    pushed, now = pair(PUSHED_RAD), pair(NOW_RAD)
    return [look("A", pushed.before), look("B", pushed.after), look("C1", now.after)]


@pytest.fixture(scope="module")
def estimate(views):
    before, after = views[0].capture.frame, views[1].capture.frame
    found = estimate_joint(before, after, joint_type="revolute")
    return found if found.axis_direction @ UP > 0.0 else found.reversed()


def begun(views, estimate, s_now: float, tmp_path) -> tuple[Any, RunRecord]:
    """A run after its first planned manipulation, which believes that joint and measured with it."""
    model: Any = SimpleNamespace(range=(-1.5, 1.5))
    belief = Belief(estimate, model, part_template(estimate), NOT_USED, NOT_USED, {})
    settings: Any = SimpleNamespace(task=TASKS["faucet"], seed=0, out=tmp_path, learn_physics=True)
    journal: Any = SimpleNamespace(stage=Stage, warn=lambda text: None)
    target = estimate.delta + ASKED_RAD
    measured = Measurement(s_now, 0.01, 0.001, 0.9)
    done = DoneManipulation(NOT_USED, (), views[-1], measured, estimate.delta, target)
    record = RunRecord(settings, journal, views=list(views), belief=belief, s_found=estimate.delta)
    record.found_view = record.origin_view = "B"
    record.origin, record.goals = estimate.delta, [Goal(target, [done])]
    return SimpleNamespace(settings=settings, journal=journal, target=target), record


class Stage:
    """A stage of the journal that keeps nothing."""

    def __init__(self, name: str) -> None:
        self.note = ""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


def off_m(belief: Belief | None) -> float:
    assert belief is not None
    estimate = belief.estimate
    return float(line_distance(estimate.axis_origin_m, estimate.axis_direction, PIVOT[None])[0])


def test_a_hinge_told_wrongly_is_told_anew_and_everything_counts_in_its_values(views, estimate, tmp_path):
    wrong = replace(
        estimate,
        axis_origin_m=estimate.axis_origin_m + np.array([-0.02, -0.03, 0.0]),
        delta=0.7 * estimate.delta,
        intervals90=Intervals(0.15, 0.04, (0.5 * estimate.delta, 1.5 * estimate.delta)),
    )
    session, record = begun(views, wrong, 0.7 * NOW_RAD, tmp_path)
    record.lessons.append(PhysicsLesson(1, tmp_path, "physics_missing", law=NOT_USED))
    assert tell_again(session, record, views[-1])
    assert newest_law(record.lessons) is None  # it was of the other joint
    assert record.lessons[0].verdict == "physics_missing"
    assert off_m(record.belief) < 0.006
    assert record.s_found == record.origin == pytest.approx(PUSHED_RAD, abs=0.03)
    assert record.s_first == 0.0
    done = record.goals[-1].last
    assert done.measured.s == pytest.approx(NOW_RAD, abs=0.03)
    assert done.s_initial == record.s_found
    assert session.target == done.s_target == record.goals[-1].target
    assert session.target == pytest.approx(record.origin + ASKED_RAD)
    assert record.show(record.origin) == TASKS["faucet"].unit.show(0.0)
    assert done.shift == pytest.approx(done.s_initial - wrong.delta)
    assert record.show(session.target) == TASKS["faucet"].unit.show(ASKED_RAD)
    assert record.goals[-1].delta_r == pytest.approx(0.0, abs=0.1)


def test_a_motion_back_is_told_from_where_the_push_left_the_part(views, estimate, tmp_path):
    back = [*views[:2], look("C1", pair(-NOW_RAD + PUSHED_RAD).after)]
    wrong = replace(
        estimate,
        axis_origin_m=estimate.axis_origin_m + np.array([-0.02, -0.03, 0.0]),
        intervals90=Intervals(0.15, 0.04, (0.5 * estimate.delta, 1.5 * estimate.delta)),
    )
    session, record = begun(back, wrong, PUSHED_RAD - NOW_RAD, tmp_path)
    assert tell_again(session, record, back[-1])
    assert (record.zero_view, record.told_view) == ("B", "C1")
    assert off_m(record.belief) < 0.006
    assert record.s_found == record.origin == 0.0
    assert record.s_first == pytest.approx(-PUSHED_RAD, abs=0.03)
    assert record.goals[-1].last.measured.s == pytest.approx(-NOW_RAD, abs=0.03)
    assert session.target == pytest.approx(ASKED_RAD)


def test_a_joint_that_the_new_view_confirms_is_kept(views, estimate, tmp_path):
    session, record = begun(views, estimate, NOW_RAD, tmp_path)
    before, target = record.belief, session.target
    assert not tell_again(session, record, views[-1])
    assert record.belief is before
    assert session.target == target


def test_a_short_motion_tells_nothing_new(views, estimate, tmp_path):
    session, record = begun(views[:2], estimate, 1.1 * estimate.delta, tmp_path)
    assert not tell_again(session, record, views[1])


@pytest.fixture
def lost(views, estimate):
    """The joint told so wrongly that the part is nowhere on its way in the newest view."""
    tilted = np.array([0.0, np.sin(0.6), np.cos(0.6)])
    return replace(
        estimate, axis_origin_m=estimate.axis_origin_m + np.array([0.0, -0.12, 0.0]), axis_direction=tilted
    )


def test_a_part_that_is_not_on_its_way_is_told_anew_from_the_look_before(views, lost, tmp_path):
    session, record = begun(views, lost, NOT_USED, tmp_path)
    record.goals[-1].attempts.clear()
    record.goals[-1] = replace(record.goals[-1], s_before=lost.delta)
    told = tell_lost(session, record, views[1], views[2])
    assert told is not None
    assert told.s == pytest.approx(NOW_RAD - PUSHED_RAD, abs=0.03)
    assert abs(told.s - (NOW_RAD - PUSHED_RAD)) < 3.0 * told.sigma
    assert (record.zero_view, record.told_view) == ("B", "C1")
    assert off_m(record.belief) < 0.006
    assert record.origin == record.s_found == record.goals[-1].s_before == 0.0
    assert session.target == record.goals[-1].target == pytest.approx(ASKED_RAD)


def test_a_drawer_and_a_view_without_the_part_are_not_told_anew(views, estimate, lost, tmp_path):
    frame = views[1].capture.frame
    noise = np.random.default_rng(0).normal(0.0, 3e-4, frame.depth_m.shape)
    same = look("C1", replace(frame, depth_m=np.where(frame.depth_m > 0.0, frame.depth_m + noise, 0.0)))
    session, record = begun([*views[:2], same], lost, NOT_USED, tmp_path)
    before, record.zero_view = record.belief, "B"
    assert tell_lost(session, record, views[1], same) is None  # nothing moved since
    assert record.belief is before
    slide = replace(estimate, joint_type="prismatic")
    session, record = begun(views, slide, NOT_USED, tmp_path)
    assert tell_lost(session, record, views[1], views[2]) is None
