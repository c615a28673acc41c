"""A small concealed set, drawn and scored here: names, silence on clean recordings, refusal to guess.

The thresholds lie below what the tool reaches on this set and above what a broken one would: chance is 1 in 30.
"""

import json

import pytest

from s2r_conceal.draw import draw_set
from s2r_conceal.score_case import score_case
from s2r_conceal.score_files import read_track
from s2r_host.gap.config import GapConfig
from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.output.answer import make_answer
from s2r_host.gap.pipeline import analyse

SEED, COUNTS, DURATION_S, SUBSTEPS = 5, {"single": 8, "clean": 3, "unknown": 2, "insufficient": 1}, 10.0, 2


def answer(case, skip=()):
    config = GapConfig(skip=tuple(skip), simulate=False, baselines=False)
    try:
        made = analyse(
            case / "model.xml", [case / "fit.csv"], [case / "holdout.csv"], [case / "repeat.csv"], config,
            lambda _: None,
        )  # fmt: skip
    except GapRecordingError as error:
        return {"exit_code": int(error.exit_code), "gap": None}
    return {"exit_code": 7, "gap": json.loads(json.dumps(make_answer(made, 0)))}


class Concealed:
    """A drawn set whose cases are answered and scored when a test first asks for their group."""

    def __init__(self, place):
        self.folder = place / "set"
        self.truths = draw_set(
            SEED,
            "one_joint",
            COUNTS,
            self.folder,
            place / "key.json",
            duration_s=DURATION_S,
            substeps=SUBSTEPS,
        )
        self._scores = {}

    def of(self, group):
        for name, truth in self.truths.items():
            if truth["group"] == group and name not in self._scores:
                case = self.folder / name
                tracks = {role: read_track(case / f"{role}.csv") for role in ("fit", "holdout")}
                self._scores[name] = score_case(name, truth, answer(case), tracks)
        return [s for s in self._scores.values() if s.group == group]


@pytest.fixture(scope="module")
def concealed(tmp_path_factory):
    return Concealed(tmp_path_factory.mktemp("concealed"))


def test_poor_motions_are_called_insufficient(concealed):
    assert all(s.answered == "insufficient" for s in concealed.of("insufficient"))


def test_single_effects_of_three_floors_and_more_are_named(concealed):
    known = [s for s in concealed.of("single") if s.strength >= 3.0]
    right = [s for s in known if s.top1_or_class]
    assert len(known) >= 4
    assert len(right) >= 0.7 * len(known), [(s.truth_names, s.answered, s.named) for s in known]


def test_clean_recordings_raise_no_alarm(concealed):
    alarms = [(s.case, s.answered, s.named) for s in concealed.of("clean") if s.false_alarm]
    assert not alarms


def test_effects_outside_the_catalogue_get_no_name(concealed):
    wrong = [(s.truth_names, s.named) for s in concealed.of("unknown") if s.wrong_name]
    assert len(wrong) <= 1, wrong
    assert any(s.answered == "unknown" for s in concealed.of("unknown"))


def test_without_the_true_effect_in_the_catalogue_its_name_is_not_given(concealed):
    def left(s):  # by the wrong values that would explain it best
        return concealed.truths[s.case]["effects"][0]["distinct"]

    strongest = max((s for s in concealed.of("single") if s.top1 and s.named), key=left, default=None)
    assert strongest is not None
    name = strongest.truth_names[0]
    found = answer(concealed.folder / strongest.case, skip=[name])["gap"]
    assert name not in [e["name"] for e in found["effects"]]
    assert found["verdict"] != "nothing_missing"
    assert found["where"][0]["joint"] == concealed.truths[strongest.case]["effects"][0]["joint"]
