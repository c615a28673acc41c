"""Which two views tell the joint."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.perception.errors import AbstainError
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
