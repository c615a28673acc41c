"""When corrections end: good enough, better left alone, or held up twice at the same place."""

from types import SimpleNamespace
from typing import Any

import pytest

from s2r_host.errors import SceneError
from s2r_host.run import reach as module
from s2r_host.run.journal import Journal
from s2r_host.run.reach import _better_left_alone, _held_up, _in_vain, _lesson, _stopped_short, _there
from s2r_host.run.reactive import StrandedError
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import TASKS


def done(s: float, target: float = 0.5, s_initial: float = 0.0, stopped: bool = False) -> Any:
    return SimpleNamespace(
        planned=SimpleNamespace(stopped=stopped),
        measured=SimpleNamespace(s=s),
        s_target=target,
        s_initial=s_initial,
        delta=target - s,
        foreseen=target,
    )


@pytest.mark.parametrize(
    ("ends", "left", "alone"),
    [
        ([0.47], 2, False),  # the first correction is always worth a try
        ([0.47, 0.475], 2, False),  # a bad one is made good by the next
        ([0.47, 0.475], 1, True),  # the last one would risk what is there
        ([0.47, 0.495], 2, True),  # much better than usual already
        ([0.1, 0.475], 2, False),  # better than one that went astray is no merit
        ([0.3, 0.44], 1, False),  # not within tolerance
    ],
)
def test_a_part_within_tolerance_is_left_alone_where_one_more_try_would_rather_spoil_it(ends, left, alone):
    assert _better_left_alone([done(s) for s in ends], tolerance=0.05, left=left) == alone


def test_a_manipulation_that_was_stopped_is_no_measure_of_the_next():
    stopped = done(0.0, stopped=True)
    assert not _better_left_alone([stopped, stopped, done(0.48)], tolerance=0.05, left=2)
    assert _better_left_alone([stopped, done(0.46), done(0.49)], tolerance=0.05, left=2)


def test_a_part_that_is_stopped_three_times_at_one_place_is_at_the_end_of_its_way():
    first, second, third = (
        done(0.40 + 0.001 * k, s_initial=0.4 if k else 0.0, stopped=True) for k in range(3)
    )
    assert _held_up([first, second, third], same=0.01)
    assert not _held_up([first, second], same=0.01)  # both may have met something else
    assert not _held_up([first, second, done(0.45, s_initial=0.40, stopped=True)], same=0.01)
    assert not _held_up([first, second, done(0.401, s_initial=0.40)], same=0.01)
    back = done(0.401, target=0.2, s_initial=0.40, stopped=True)
    assert not _held_up([first, second, back], same=0.01)


@pytest.mark.parametrize(
    ("off", "sigma", "there"),
    [
        (0.5, 0.0, True),  # in shares of what is good enough
        (1.4, 0.1, False),
        (1.4, 0.7, True),  # the measurement cannot tell
        (1.4, float("inf"), False),  # nothing is known of its error
        (1.6, 50.0, False),  # so much has to be tried, however unsure
    ],
)
def test_no_correction_is_smaller_than_what_the_measurement_tells(off, sigma, there):
    task = TASKS["laptop"]
    manipulation = done(0.5 - off * task.good_enough)
    manipulation.measured.sigma = sigma * task.good_enough
    assert _there(manipulation, task) == there


@pytest.mark.parametrize(
    ("s", "target", "in_vain"),
    [
        (0.005, 0.4, True),
        (0.2, 0.4, False),  # it moved
        (0.005, 0.1, False),  # a correction as small as this may be all friction
    ],
)
def test_a_part_that_was_to_go_far_and_stayed_was_pushed_in_vain(s, target, in_vain):
    assert _in_vain(done(s, target=target), TASKS["faucet"]) == in_vain


@pytest.mark.parametrize(
    ("s", "stopped", "short"),
    [
        (0.2, True, True),
        (0.2, False, False),  # it slipped off: the place is learnt from by other rules
        (0.38, True, False),  # stopped where it was to be
    ],
)
def test_a_place_from_which_the_arm_was_stopped_on_its_way_is_avoided(s, stopped, short):
    assert _stopped_short(done(s, target=0.4, stopped=stopped), TASKS["faucet"]) == short


@pytest.mark.parametrize(
    ("offset", "positive", "lesson"),
    [
        (0.05, True, 0.05),
        (-0.05, True, -0.05),
        (0.3, True, 0.1),  # it went on by itself, and will again
        (-0.3, True, 0.0),  # the fingertip slipped
        (-0.3, False, -0.1),
        (0.3, False, 0.0),
    ],
)
def test_a_part_that_went_far_beyond_is_a_lesson_and_one_that_fell_far_short_is_none(
    offset, positive, lesson
):
    assert _lesson(offset, 0.1, positive=positive) == pytest.approx(lesson)


@pytest.mark.parametrize("seen", [True, False])
def test_a_manipulation_after_which_there_is_no_way_home_is_measured_from_there(tmp_path, monkeypatch, seen):
    notes, view = [], SimpleNamespace(name="C1")
    settings = RunSettings(0.1, tmp_path / "run", reactive=True)
    session: Any = SimpleNamespace(
        settings=settings, target=0.1, journal=Journal(),
        recorder=SimpleNamespace(add_note=lambda kind, values: notes.append((kind, values["number"], values["s"]))),
    )  # fmt: skip
    record = RunRecord(settings, session.journal)
    record.belief, nothing = SimpleNamespace(), None  # type: ignore[assignment]
    record.goals.append(Goal(0.1, s_before=0.0))
    monkeypatch.setattr(RunRecord, "add_view", lambda _record, look: look)
    planned: Any = SimpleNamespace(
        result=SimpleNamespace(control_steps=1), foreseen=0.1, corrected=True,
        delivery=SimpleNamespace(trajectory=SimpleNamespace(duration_s=1.0)),
    )  # fmt: skip

    def carried_out(*_):
        raise StrandedError("no way out of contact", planned, ())

    def measured(*_, **__):
        if not seen:
            raise SceneError("the drawer is hidden")
        return SimpleNamespace(s=0.095, sigma=1e-4)

    monkeypatch.setattr(module, "prepare_manipulation", lambda *_: planned)
    monkeypatch.setattr(module, "carry_out_reactively", carried_out)
    monkeypatch.setattr(module, "observe", lambda *_: view)
    monkeypatch.setattr(module, "measure_in", measured)
    with pytest.raises(StrandedError, match="no way out of contact"):
        module.reach(session, record, nothing, nothing, 0.0)  # type: ignore[arg-type]
    assert [(one.measured.s, one.view) for one in record.attempts] == ([(0.095, view)] if seen else [])
    assert notes == ([("state", 1, 0.095)] if seen else [])
    assert bool(session.journal.warnings) != seen
