"""Which two views tell the joint."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.errors import NoMotionError, SceneError
from s2r_host.perception.errors import AbstainError, NothingMovedError
from s2r_host.run import push_until_told
from s2r_host.run.push_until_told import _compared, _earlier
from s2r_host.run.task import DRAWER, FAUCET

SESSION: Any = SimpleNamespace(settings=SimpleNamespace(task=None, seed=0))


def push(name: str, went_through: bool = True, moved: bool | None = None) -> Any:
    """A push of that name; ``moved``: as colours tell, if they do."""
    motion = SimpleNamespace(push_at_part=name, proposal=SimpleNamespace(p_contact=np.zeros(3)))
    planned = SimpleNamespace(motion=motion)
    return SimpleNamespace(
        planned=planned, went_through=went_through, moved=moved is not False, sure=moved is not None
    )


def compared(
    monkeypatch: pytest.MonkeyPatch, names: str, telling: str, through: str = "", moving: str | None = None
) -> tuple[Any, list[tuple[str, Any]]]:
    """Compare views of these names where only some of them tell the joint together with the newest.

    Pushes are named after the views that they lead to; ``through``: those that nothing stopped; ``moving``: those
    that are seen to have moved something, where that is seen.
    """
    asked: list[tuple[str, Any]] = []

    def estimate(before: Any, after: Any, task: Any, positive: Any, pushed: Any, seed: int) -> str:
        assert after.name == names[-1]
        asked.append((before.name, pushed))
        if before.name not in telling:
            raise AbstainError(f"{before.name} does not tell")
        return f"{before.name}{after.name}"

    monkeypatch.setattr(push_until_told, "estimate_part", estimate)
    views: list[Any] = [SimpleNamespace(name=name) for name in names]
    pushes = [push(name, name in through, None if moving is None else name in moving) for name in names[1:]]
    return _compared(SESSION, views, pushes, None), asked


def test_the_first_view_counts_as_long_as_it_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    (before, estimate), asked = compared(monkeypatch, "ABCD", "ABC")
    assert (before.name, estimate) == ("A", "AD")
    assert len(asked) == 1


def test_later_views_are_asked_from_the_newest_on(monkeypatch: pytest.MonkeyPatch) -> None:
    (before, _), asked = compared(monkeypatch, "ABCD", "B")
    assert before.name == "B"
    assert [name for name, _ in asked] == ["A", "C", "B"]


def test_only_a_single_push_says_how_the_part_was_pushed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compared(monkeypatch, "AB", "A")[1] == [("A", ["B"])]
    assert compared(monkeypatch, "ABC", "B", "BC")[1] == [("A", []), ("B", ["C"])]


def test_pushes_that_were_held_out_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compared(monkeypatch, "ABCD", "A", "C")[1] == [("A", ["C"])]
    assert compared(monkeypatch, "ABCD", "A", "")[1] == [("A", [])]


def test_what_is_seen_to_move_counts_more_than_what_held_out(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compared(monkeypatch, "ABCD", "A", "BC", moving="D")[1] == [("A", ["D"])]
    assert compared(monkeypatch, "ABCD", "A", "C", moving="BD")[1] == [("A", ["B", "D"])]
    assert compared(monkeypatch, "ABC", "A", "BC", moving="")[1] == [("A", [])]


def test_after_pushes_on_two_drawers_the_newest_two_views_are_compared_first() -> None:
    low, high, high_too = push("B"), push("C"), push("D")
    for one, z in ((low, 0.05), (high, 0.20), (high_too, 0.22)):
        one.planned.motion.proposal.p_contact = np.array([0.6, 0.0, z])
    assert _earlier([low], DRAWER) == [0]
    assert _earlier([low, high], DRAWER) == [1, 0]
    assert _earlier([low, high, high_too], DRAWER) == [2, 1, 0]
    assert _earlier([high, high_too], DRAWER) == [0, 1]
    assert _earlier([low, high], FAUCET) == [0, 1]
    low.moved = False
    assert _earlier([low, high], DRAWER) == [0, 1]


def test_where_no_pair_tells_the_reason_is_the_first_views(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(AbstainError, match="A does not tell"):
        compared(monkeypatch, "ABC", "")


class Pushed:
    """A run whose pushes tell, in turn: a share of the motion that is known, or an error; ``None``: out of reach."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *told: Any, task: Any = FAUCET) -> None:
        self.warnings: list[str] = []
        outcomes, stage = iter(told), SimpleNamespace(note="")
        settings = SimpleNamespace(task=task, pushes=6, dry_run=False, seed=0)
        journal = SimpleNamespace(stage=lambda _: nullcontext(stage), warn=self.warnings.append)
        self.session: Any = SimpleNamespace(settings=settings, journal=journal)
        self.record: Any = SimpleNamespace(add_view=lambda view: view, planned_push=None, push=None)
        self.next: Any = None

        def prepare(*_: Any) -> Any:
            self.next = next(outcomes)
            if self.next is None:
                raise NoMotionError("no proposal is reachable")
            if isinstance(self.next, NothingInViewError):
                raise self.next
            return SimpleNamespace(motion=SimpleNamespace(tried=1), positive=None)

        def compare(_: Any, views: Any, *__: Any) -> Any:
            if isinstance(self.next, Exception):
                raise self.next
            delta, half = 0.5, 0.5 * self.next
            interval = SimpleNamespace(delta=(delta - half, delta + half))
            return views[0], SimpleNamespace(delta=delta, intervals90=interval, explained=0.9, warnings=())

        done = push_until_told.DonePush(None, (), True)  # type: ignore[arg-type]
        for name, value in {
            "prepare_push": prepare,
            "carry_out_push": lambda *_: done,
            "observe": lambda _, name: SimpleNamespace(name=name, scene=SimpleNamespace(p_base=[])),
            "seen_to_move": lambda *_: None,
            "_compared": compare,
            "KnobWatch": lambda _: SimpleNamespace(now=(), look=lambda _: None, joint=lambda: None),
        }.items():
            monkeypatch.setattr(push_until_told, name, value)

    def go(self) -> Any:
        first: Any = SimpleNamespace(name="A")
        return push_until_told.push_until_told(self.session, self.record, first)


class NothingInViewError(SceneError):
    """No further push can be prepared, for another reason than reach."""


UNSEEN = NothingInViewError("nothing in this view that looks like a lever gives way")
VAGUE, TOLD, NOTHING, ASTRAY = 0.3, 0.05, NothingMovedError("no motion"), AbstainError("not rigid")


def test_a_lever_told_vaguely_is_pushed_further(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Pushed(monkeypatch, VAGUE, TOLD)
    told = run.go()
    assert (told.after.name, told.share) == ("B2", pytest.approx(TOLD))
    assert "push 1 tells the motion to 30 % only" in run.warnings[0]


def test_other_parts_are_taken_as_they_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Pushed(monkeypatch, VAGUE, TOLD, task=DRAWER).go().after.name == "B"


def test_the_last_push_may_tell_as_vaguely_as_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Pushed(monkeypatch, *[VAGUE] * 6).go()
    assert (told.after.name, told.share) == ("B6", pytest.approx(VAGUE))


def test_what_was_told_vaguely_counts_where_no_further_push_is_reachable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert Pushed(monkeypatch, VAGUE, None).go().after.name == "B"
    assert Pushed(monkeypatch, VAGUE, UNSEEN).go().after.name == "B"
    assert Pushed(monkeypatch, ASTRAY, VAGUE, NOTHING, None).go().after.name == "B2"
    with pytest.raises(NoMotionError):
        Pushed(monkeypatch, ASTRAY, None).go()


def test_what_was_told_vaguely_counts_no_more_once_the_part_was_moved_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert Pushed(monkeypatch, VAGUE, *[NOTHING] * 5).go().after.name == "B"
    with pytest.raises(AbstainError, match="not rigid"):
        Pushed(monkeypatch, VAGUE, *[NOTHING] * 4, ASTRAY).go()
    with pytest.raises(NoMotionError):
        Pushed(monkeypatch, VAGUE, ASTRAY, None).go()
