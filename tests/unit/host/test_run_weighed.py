"""A law with moderate evidence is believed only where it foretells the motions made so far better."""

from types import SimpleNamespace
from typing import Any

import pytest

from s2r_host.run import weighed
from s2r_host.run.journal import Journal
from s2r_host.run.physics import PhysicsLesson, newest_law
from s2r_host.run.record import Goal, RunRecord
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import DRAWER
from s2r_host.run.weighed import weigh_newest

ENDED = 0.10  # where all motions left the part [m]
LAWS: dict[str, Any] = {"old": SimpleNamespace(ends=0.102), "good": SimpleNamespace(ends=0.1005)}
LAWS["bad"], LAWS["gone"] = SimpleNamespace(ends=0.1019), SimpleNamespace(ends=None)


@pytest.fixture
def taught(tmp_path, monkeypatch):
    """``taught(law, probability)``: the record after such a lesson; without any, 104 mm are foreseen for 100."""
    monkeypatch.setattr(weighed, "tells", lambda done, task: not done.stopped)
    monkeypatch.setattr(
        weighed, "foreseen", lambda done, session, belief, law, folder: 0.104 if law is None else law.ends
    )

    def made(law: str, probability: float, earlier: str | None = None, stopped: bool = False) -> RunRecord:
        settings = RunSettings(0.1, tmp_path / "run", task=DRAWER, learn_physics=True)
        record = RunRecord(settings, Journal())
        record.belief = SimpleNamespace()  # type: ignore[assignment]
        motion: Any = SimpleNamespace(stopped=stopped, measured=SimpleNamespace(s=ENDED))
        record.goals.append(Goal(ENDED, [motion, motion]))
        if earlier is not None:
            record.lessons.append(PhysicsLesson(3, tmp_path, "physics_missing", law=LAWS[earlier]))
        effect = {"name": "spring_return", "probability": probability}
        record.lessons.append(
            PhysicsLesson(
                6, tmp_path, "physics_missing", (effect,), carried=("spring_return",), law=LAWS[law]
            )
        )
        weigh_newest(SimpleNamespace(settings=settings, journal=record.journal), record)  # type: ignore[arg-type]
        return record

    return made


def test_a_sure_effect_is_believed_whatever_the_motions_say(taught):
    assert newest_law(taught("gone", 0.98).lessons) is LAWS["gone"]


def test_an_unsure_effect_that_foretells_the_motions_is_believed(taught):
    assert newest_law(taught("good", 0.84).lessons) is LAWS["good"]


@pytest.mark.parametrize("law", ["bad", "gone"])
def test_an_unsure_effect_that_foretells_them_no_better_is_named_and_not_carried(taught, law):
    record = taught(law, 0.84, earlier="old")
    assert newest_law(record.lessons) is LAWS["old"]
    lesson = record.lessons[-1]
    assert [effect["name"] for effect in lesson.effects] == ["spring_return"]
    assert lesson.carried == ()
    assert lesson.not_carried == ("spring_return",)
    assert lesson.notes[-1].startswith("spring_return not sure: the motions so far ended +2.00 mm beside")


def test_without_a_motion_that_tells_an_unsure_effect_is_not_believed(taught):
    assert newest_law(taught("good", 0.84, stopped=True).lessons) is None
