"""A second look, under the noise of the channels alone, replaces the first where it tells more."""

from types import SimpleNamespace

import pytest

from s2r_host.gap import pipeline
from s2r_host.gap.config import GapConfig


def decided(verdict, held, named=()):
    """A decision whose explanation leaves a mean square of ``held`` [N²·m²] of the held-out effort over."""
    effects = [SimpleNamespace(joint=joint) for joint in named]
    return SimpleNamespace(
        verdict=verdict, leftover=1.0, solution=SimpleNamespace(raw_held=(9.0, held)), effects=effects
    )


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
    found = looked_again(monkeypatch, first, second, guessed={0: 1.0}, finer={0: 0.1})
    assert (found is not None) == taken


def test_a_floor_that_is_somewhat_finer_counts_on_joints_that_nothing_is_named_on(monkeypatch):
    better = decided("physics_missing", 0.24)
    for named, taken in ((("shoulder",), False), (("elbow",), True)):
        first = decided("physics_missing", 0.46, named)
        found = looked_again(monkeypatch, first, better, guessed={0: 1.0, 1: 1.0}, finer={0: 0.6, 1: 1.0})
        assert (found is not None) == taken


def looked_again(monkeypatch, first, second, guessed, finer):
    """What a second look takes that decides ``second``, with floors by joint."""
    floors = [
        SimpleNamespace(joints=tuple(one), floor=one, floor_source="estimated") for one in (guessed, finer)
    ]
    monkeypatch.setattr(pipeline, "_stated", lambda *_, **__: floors[1])
    monkeypatch.setattr(pipeline, "Search", lambda *_: None)
    monkeypatch.setattr(pipeline, "decide", lambda *_: second)
    monkeypatch.setattr(pipeline, "doubt", lambda _: 1.0)
    analysis = SimpleNamespace(model=SimpleNamespace(joints=("shoulder", "elbow")))
    return pipeline._second_look(analysis, GapConfig(), floors[0], first, lambda _: None)  # type: ignore[arg-type]
