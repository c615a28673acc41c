"""How a run with several targets ends: by all of them, not by the one that happened to be the last."""

from types import SimpleNamespace
from typing import Any

import pytest

from s2r_host.errors import SceneError
from s2r_host.run import lost_motion, physics, pipeline
from s2r_host.run.journal import Journal
from s2r_host.run.physics import PhysicsLesson
from s2r_host.run.reactive import StrandedError
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.settings import RunSettings
from s2r_protocol.exits import ExitCode, RefusedError

NOT_USED: Any = None
SAID = "no plan takes the drawer there"


def done(s: float, target: float) -> Any:
    return SimpleNamespace(measured=SimpleNamespace(s=s), delta=target - s)


@pytest.mark.parametrize(
    ("ends", "code", "reached", "said"),
    [
        ([0.101, 0.049], ExitCode.OK, True, "after 1 planned manipulation"),
        ([0.12, 0.049], ExitCode.DIFFERENCE, True, "; 1 of 2 targets missed by more than 5.00 mm"),
        ([0.101, 0.07], ExitCode.DIFFERENCE, False, ", more than 5.00 mm; look at the report's contact surfaces"),
        ([None, 0.049], ExitCode.REFUSED, True, f"target +100.00 mm was left out: {SAID}; then drawer at +49.00 mm"),
        ([0.101, None], ExitCode.REFUSED, False, f"; then target +50.00 mm was left out: {SAID}"),
    ],
)  # fmt: skip
def test_a_target_that_was_missed_or_left_out_counts_whatever_came_after_it(
    tmp_path, ends, code, reached, said
):
    record = RunRecord(RunSettings(0.1, tmp_path / "run", then=(0.05,), go_on=True), Journal())
    for target, s in zip((0.1, 0.05), ends, strict=True):
        record.goals.append(Goal(target, [] if s is None else [done(s, target)], 0.0, "" if s else SAID))
    assert pipeline._judge(record) == reached
    assert record.code == code
    assert said in record.reason


def looped(monkeypatch, settings, reached) -> tuple[Any, RunRecord]:
    """The loop over the targets of some settings with a part found at 0; what takes it to each is given."""
    told: Any = SimpleNamespace(
        estimate=SimpleNamespace(delta=0.0, axis_direction=SimpleNamespace(tolist=list)),
        before=SimpleNamespace(name="A", scene=SimpleNamespace(p_base=[])), after=SimpleNamespace(name="B"),
    )  # fmt: skip
    belief = SimpleNamespace(model=SimpleNamespace(range=(0.0, 0.3), pieces=(), warnings=()))
    session: Any = SimpleNamespace(
        settings=settings, journal=Journal(), arm=None, executed=[],
        recorder=SimpleNamespace(add_note=lambda *_: None),
    )  # fmt: skip
    record = RunRecord(settings, session.journal)
    monkeypatch.setattr(pipeline, "_home", lambda *_: None)
    monkeypatch.setattr(pipeline, "observe", lambda *_: told.before)
    monkeypatch.setattr(RunRecord, "add_view", lambda _record, view: view)
    monkeypatch.setattr(pipeline, "push_until_told", lambda *_: told)
    monkeypatch.setattr(pipeline, "build_belief", lambda *_: belief)
    monkeypatch.setattr(pipeline, "learn_from_push", lambda *_: None)
    monkeypatch.setattr(pipeline, "reach", reached)
    pipeline._loop(session, record, lambda _record: 0.0)
    return session, record


def test_targets_keep_their_numbers_where_one_is_left_out(tmp_path, monkeypatch):
    """Of three the third is slow, and the lesson after it counts on that."""
    numbers: list[int] = []

    def reached(session, record, *_):
        numbers.append(len(record.goals))
        if len(numbers) == 2:
            raise RefusedError(SAID)
        record.goals[-1].attempts.append(done(session.target, session.target))

    settings = RunSettings(0.1, tmp_path / "run", then=(0.05, 0.15), from_pushed=True, go_on=True)
    session, record = looped(monkeypatch, settings, reached)
    assert numbers == [1, 2, 3]
    assert record.code == ExitCode.REFUSED
    assert [goal.refused for goal in record.goals] == ["", SAID, ""]
    assert f"going on without this target: {SAID}" in session.journal.warnings


@pytest.mark.parametrize(
    "error",
    [
        StrandedError("no way out of contact", NOT_USED, ()),
        SceneError("only 12 % of the moving part is seen"),
    ],
    ids=["no way home", "not seen afterwards"],
)
def test_a_run_does_not_go_on_once_the_arm_has_moved_for_a_target(tmp_path, monkeypatch, error):
    """It cannot be left out then: where the part stands now was not seen, or the arm stands beside it."""

    def reached(session, *_):
        session.executed.append("manipulation 1")
        raise error

    settings = RunSettings(0.1, tmp_path / "run", then=(0.05,), from_pushed=True, go_on=True)
    with pytest.raises(type(error)):
        looped(monkeypatch, settings, reached)


@pytest.mark.parametrize(
    ("ends", "after"),
    [
        ([0.1, 0.05, 0.15, 0.05], [3]),
        ([0.1, 0.15, "there", 0.05], [2]),
        ([0.1, 0.05, None, 0.05], [2]),
        ([0.1, None, None, None, None, None, 0.1], [1]),
        ([None, None, None, 0.05], []),
        ([0.1, 0.05, 0.15], []),
    ],
    ids=["moved", "there already", "left out", "nothing new", "never moved", "the last"],
)
def test_the_lesson_after_a_third_target_does_not_wait_for_the_sixth(tmp_path, monkeypatch, ends, after):
    """Where the motions leave the part; None: none could be planned."""
    targets = [(0.1, 0.05, 0.15, 0.05, 0.15, 0.05, 0.1)[k] for k in range(len(ends))]

    def reached(session, record, *_):
        if (s := ends[len(record.goals) - 1]) is None:
            raise RefusedError(SAID)
        record.goals[-1].attempts.append(done(s, session.target))

    lost: list[int] = []
    monkeypatch.setattr(physics, "before_target", lambda *_: None)
    monkeypatch.setattr(
        physics, "_asked", lambda _session, _record, folder: PhysicsLesson(0, folder, "unknown")
    )
    monkeypatch.setattr(
        lost_motion, "learn_lost_motion", lambda _session, record: lost.append(len(record.goals))
    )
    first, *then = targets
    settings = RunSettings(
        first, tmp_path / "run", then=tuple(then), from_pushed=True, go_on=True, learn_physics=True
    )
    _, record = looped(monkeypatch, settings, reached)
    assert [lesson.after for lesson in record.lessons] == after
    assert all(record.goals[number - 1].attempts for number in lost)
