"""What a run says of the part in its first view, from wherever its joint values and its targets count."""

from types import SimpleNamespace
from typing import Any

import pytest

from s2r_host.errors import SceneError
from s2r_host.run import measure_view, pipeline
from s2r_host.run.journal import Journal
from s2r_host.run.record import RunRecord
from s2r_host.run.settings import RunSettings

NOT_SEEN, PUSHED = None, 0.06
FIRST: Any = SimpleNamespace(name="A")


def believed(monkeypatch, tmp_path, from_pushed: bool, s_first: float | None) -> RunRecord:
    """After a second push told the joint, from the view that the first one had led to."""

    def measured(*_: Any, **__: Any) -> Any:
        if s_first is NOT_SEEN:
            raise SceneError("hidden")
        return SimpleNamespace(s=s_first)

    told: Any = SimpleNamespace(
        estimate=SimpleNamespace(delta=PUSHED, axis_direction=SimpleNamespace(tolist=list)),
        before=SimpleNamespace(name="B"), after=SimpleNamespace(name="B2"),
    )  # fmt: skip
    model = SimpleNamespace(range=(-0.1, 0.3), pieces=(), warnings=())
    settings = RunSettings(0.1, tmp_path / "run", from_pushed=from_pushed)
    recorder = SimpleNamespace(add_note=lambda *_: None)
    session: Any = SimpleNamespace(settings=settings, journal=Journal(), recorder=recorder)
    record = RunRecord(settings, session.journal)
    monkeypatch.setattr(pipeline, "build_belief", lambda *_: SimpleNamespace(model=model))
    monkeypatch.setattr(measure_view, "measure_in", measured)
    pipeline._believe(session, record, FIRST, told)
    return record


@pytest.mark.parametrize(("from_pushed", "origin"), [(True, PUSHED), (False, -0.04)])
def test_a_joint_told_from_a_later_view_has_a_value_in_the_first_one(
    monkeypatch, tmp_path, from_pushed, origin
):
    record = believed(monkeypatch, tmp_path, from_pushed, s_first=-0.04)
    assert (record.s_first, record.origin) == (-0.04, origin)


def test_a_part_hidden_in_the_first_view_has_none_and_stops_only_what_counts_from_there(
    monkeypatch, tmp_path
):
    record = believed(monkeypatch, tmp_path, True, NOT_SEEN)
    assert (record.s_first, record.origin) == (None, PUSHED)
    with pytest.raises(SceneError):
        believed(monkeypatch, tmp_path, False, NOT_SEEN)
