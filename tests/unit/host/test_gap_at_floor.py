"""The nominal model within a guessed noise floor: nothing is missing, unless an effect clearly beats every number."""

from types import SimpleNamespace

import pytest

from s2r_host.gap.verdict import decide


class Looked(Exception):
    """The catalogue was searched."""


def looked(*_, **__):
    raise Looked


@pytest.mark.parametrize("beats", [True, False])
def test_what_beats_every_number_is_looked_for_though_a_guessed_floor_holds_it(monkeypatch, beats):
    search = SimpleNamespace(
        at_floor=lambda chosen: True, beats_numbers=lambda: beats, stands_out=lambda *_: False, run=looked,
        finish=lambda *_: None, looseness=0.0,
    )  # fmt: skip
    one = decide.Decision("nothing_missing", None)  # type: ignore[arg-type]
    monkeypatch.setattr(decide, "search_under_both", looked)
    monkeypatch.setattr(decide, "parameters_only", lambda *_: one)
    monkeypatch.setattr(decide, "too_much_left", lambda *_: False)
    problem = SimpleNamespace(joints=[0])
    if beats:
        with pytest.raises(Looked):
            decide._from_plant(problem, search, lambda _: None)  # type: ignore[arg-type]
    else:
        assert decide._from_plant(problem, search, lambda _: None) is one  # type: ignore[arg-type]
