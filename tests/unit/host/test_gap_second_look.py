"""A second look, under the noise of the channels alone, replaces the first where it tells more."""

from types import SimpleNamespace

import pytest

from s2r_host.gap import pipeline
from s2r_host.gap.config import GapConfig


def decided(verdict, held):
    """A decision whose explanation leaves a mean square of ``held`` [N²·m²] of the held-out effort over."""
    return SimpleNamespace(verdict=verdict, leftover=1.0, solution=SimpleNamespace(raw_held=(9.0, held)))


@pytest.mark.parametrize(
    ("first", "second", "taken"),
    [
        (decided("physics_missing", 0.24), decided("physics_missing", 0.46), False),
        (decided("physics_missing", 0.46), decided("physics_missing", 0.24), True),
        (decided("nothing_missing", 0.24), decided("physics_missing", 0.25), True),
        (decided("unknown", 0.24), decided("physics_missing", 0.25), True),
    ],
)
def test_names_under_a_finer_floor_have_to_predict_as_well_as_those_there_are(
    monkeypatch, first, second, taken
):
    finer = SimpleNamespace(joints=(0,), floor={0: 0.1}, floor_source="estimated")
    monkeypatch.setattr(pipeline, "_stated", lambda *_, **__: finer)
    monkeypatch.setattr(pipeline, "Search", lambda *_: None)
    monkeypatch.setattr(pipeline, "decide", lambda *_: second)
    monkeypatch.setattr(pipeline, "doubt", lambda _: 1.0)
    guessed = SimpleNamespace(joints=(0,), floor={0: 1.0})
    found = pipeline._second_look(None, GapConfig(), guessed, first, lambda _: None)  # type: ignore[arg-type]
    assert (found is not None) == taken
