"""The nominal model within a guessed noise floor: nothing is missing, unless an effect clearly beats every number."""

from types import SimpleNamespace

import pytest

from s2r_host.gap.verdict import decide


class Looked(Exception):
    """The catalogue was searched."""


def looked(*_, **__):
    raise Looked


@pytest.mark.parametrize(
    ("beats", "knocks", "clear", "searched"),
    [
        (True, False, False, True),  # a guessed floor holds it
        (False, True, True, True),  # the floor is as high as knocks that no two runs share
        (False, True, False, False),
        (False, False, True, False),
        (False, False, False, False),
    ],
)
def test_at_the_floor_the_catalogue_is_searched_for_what_a_floor_may_hold(
    monkeypatch, beats, knocks, clear, searched
):
    search = SimpleNamespace(
        at_floor=lambda chosen: True, beats_numbers=lambda: beats, run=looked, looseness=0.0,
        stands_out=lambda *_: clear, finish=lambda *_: SimpleNamespace(unexplained=None),
    )  # fmt: skip
    one = decide.Decision("nothing_missing", None)  # type: ignore[arg-type]
    monkeypatch.setattr(decide, "search_under_both", looked)
    monkeypatch.setattr(decide, "parameters_only", lambda *_: one)
    monkeypatch.setattr(decide, "too_much_left", lambda *_: False)
    monkeypatch.setattr(decide, "bursts", lambda *_: "knocks" if knocks else None)
    problem = SimpleNamespace(joints=[0])
    if searched:
        with pytest.raises(Looked):
            decide._from_plant(problem, search, lambda _: None)  # type: ignore[arg-type]
    else:
        assert decide._from_plant(problem, search, lambda _: None) is one  # type: ignore[arg-type]
