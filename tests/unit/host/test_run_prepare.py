"""Which plans are tried for a manipulation, and what is taken when none ends on target."""

from types import SimpleNamespace
from typing import Any

import pytest

from s2r_host.errors import TargetError
from s2r_host.planning import OutOfReachError, patience
from s2r_host.planning.patience import Patience
from s2r_host.run import prepare
from s2r_host.run.task import FAUCET
from s2r_host.run.tries import FailedTry, Try, grouped
from s2r_host.trajectory.deliver import MotionHitsError

TARGET = 0.4
STOPS = [0.1, 0.25]
VIEW: Any = None


class Trial:
    """A stand-in for the planner that finds what `finds` says of target and tolerance: a plan, a fragile one, none."""

    def __init__(self, monkeypatch, finds):
        self.asked: list[tuple[float, float, float | None]] = []
        self.seeds: list[int] = []
        self.warnings: list[str] = []
        self.failed_tries: list[FailedTry] = []
        self._finds = finds
        monkeypatch.setattr(prepare, "planned_once", self._once)
        monkeypatch.setattr(prepare, "_stops", lambda *_: STOPS)

    def _once(self, _session, _belief, _number, _s, _view, one):
        self.asked.append((one.s_target, one.doubt, one.tolerance))
        self.seeds.append(one.number)
        found = self._finds(one.s_target, one.tolerance)
        if not found:
            raise TargetError(f"no way to {one.s_target}")
        delivery = SimpleNamespace(fragile=None, hits=False, strays=0.0)
        if found not in (True, "edge"):  # how far from the target some object ends
            delivery = SimpleNamespace(fragile="fragile: it slips", hits=False, strays=found)
        end = SimpleNamespace(at_edge=found == "edge")
        request = SimpleNamespace(s_target=one.s_target)
        return SimpleNamespace(foreseen=one.s_target - 0.01, delivery=delivery, end=end, request=request)

    def prepare(self, s_initial=0.0, number=1):
        session: Any = SimpleNamespace(
            target=TARGET,
            settings=SimpleNamespace(task=FAUCET, plan_time_s=300.0),
            journal=SimpleNamespace(
                warn=self.warnings.append, failed_tries=self.failed_tries, doing=lambda _: None
            ),
        )
        belief: Any = None
        return prepare.prepare_manipulation(session, belief, number, s_initial, VIEW, "{:.2f}".format)


def test_a_plan_that_ends_on_target_is_taken_without_a_word(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: True)
    trial.prepare()
    assert trial.asked == [(TARGET, 1.0, None)]
    assert not trial.warnings


def test_a_plan_that_pushes_an_edge_is_taken_where_no_quick_one_does_without(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: "edge")
    assert trial.prepare().end.at_edge
    assert trial.asked == [(TARGET, 1.0, None)] * prepare.QUICK_TRIES
    assert not trial.warnings
    answers = iter(["edge", True])
    other = Trial(monkeypatch, lambda target, tolerance: next(answers))
    assert not other.prepare().end.at_edge
    assert [failed.reason for failed in other.failed_tries] == ["it pushes the part at an edge"]


def test_a_state_on_the_way_comes_before_one_beside_the_target(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: target < TARGET)
    assert trial.prepare().foreseen == pytest.approx(STOPS[0] - 0.01)
    assert len(trial.asked) == len(prepare.DOUBTS) + 1
    assert "no way to 0.4" in trial.warnings[0]
    assert "first to 0.09" in trial.warnings[0]


def test_beside_the_target_is_better_than_nothing(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: tolerance is not None)
    assert trial.prepare().foreseen == pytest.approx(TARGET - 0.01)
    target, doubt, tolerance = trial.asked[-1]
    assert (target, doubt) == (TARGET, prepare.STOP_DOUBTS[0])
    assert tolerance == pytest.approx(prepare.ROUGHLY * TARGET)
    assert len(set(trial.seeds)) == len(trial.seeds)


def test_when_nothing_is_found_the_reasons_of_all_tries_are_told_and_kept(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: False)
    with pytest.raises(TargetError, match=r"from 0.00 to 0.40 \(10 tries: 10 × no way to 0.4\); try another"):
        trial.prepare()
    assert len(trial.asked) == len(prepare.DOUBTS) + len(prepare.STOP_DOUBTS) * (len(STOPS) + 1)
    kept = [one.as_json() for one in trial.failed_tries]
    assert [(one["s_target"], one["doubt"], one["tolerance"]) for one in kept] == trial.asked
    assert kept[-1]["reason"] == "no way to 0.4"
    assert {one["manipulation"] for one in kept} == {1}


def test_no_further_try_is_begun_once_the_time_for_them_is_up(monkeypatch):
    """Each takes 120 s here, of 300: three on target, then as long for the next best, which is found."""
    now = [0.0]

    def finds(target, tolerance):
        now[0] += 120.0
        return tolerance is not None

    monkeypatch.setattr(patience, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    monkeypatch.setattr(prepare, "Patience", lambda *told: Patience(*told, started_s=now[0]))
    trial = Trial(monkeypatch, finds)
    monkeypatch.setattr(prepare, "_stops", lambda *_: [])
    assert trial.prepare().foreseen == pytest.approx(TARGET - 0.01)
    assert [tolerance is None for _, _, tolerance in trial.asked] == [True, True, True, False]


def test_where_a_fingertip_fits_nowhere_it_is_not_tried_again_with_the_same_doubt(monkeypatch):
    trial, asked = Trial(monkeypatch, lambda target, tolerance: True), []

    def once(_session, _belief, _number, _s, _view, one):
        asked.append((one.s_target, one.doubt))
        raise OutOfReachError("object: out of reach")

    monkeypatch.setattr(prepare, "planned_once", once)
    doubts = sorted(set(prepare.DOUBTS), reverse=True)
    with pytest.raises(TargetError, match=rf"\({len(doubts)} tries: {len(doubts)} × object: out of reach\)"):
        trial.prepare()
    at_target = [doubt for target, doubt in asked if target == TARGET]
    assert at_target == doubts
    assert {target for target, _ in asked} == {TARGET, *STOPS}
    assert len(asked) == len(set(asked))


def test_a_fragile_plan_that_is_surely_worth_it_comes_before_a_state_on_the_way(monkeypatch):
    strays = iter([0.3 * TARGET, 0.1 * TARGET])
    trial = Trial(
        monkeypatch,
        lambda target, tolerance: target < TARGET or next(strays, False) if not tolerance else False,
    )
    taken = trial.prepare()
    assert taken.delivery.strays == pytest.approx(0.1 * TARGET)
    assert len(trial.asked) == len(prepare.DOUBTS)
    assert "2 × fragile: it slips" in trial.warnings[0]
    assert "ends at most 2.29° from it is taken" in trial.warnings[0]


def test_a_fragile_plan_that_may_be_worth_nothing_comes_after_all_others(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: 0.9 * TARGET if target == TARGET else False)
    assert trial.prepare().delivery.strays == pytest.approx(0.9 * TARGET)
    assert len(trial.asked) == len(prepare.DOUBTS) + len(prepare.STOP_DOUBTS) * (len(STOPS) + 1)


def test_a_fragile_plan_to_a_stop_counts_by_how_far_from_the_target_it_may_end(monkeypatch):
    """Such a plan may end on the far side of where the part is now."""
    trial = Trial(monkeypatch, lambda target, tolerance: 0.9 * TARGET if target < TARGET else False)
    with pytest.raises(TargetError, match=r"10 tries"):
        trial.prepare()
    strays = {STOPS[0]: 0.01, STOPS[1]: 0.02}
    trial = Trial(monkeypatch, lambda target, tolerance: strays.get(target, False))
    assert trial.prepare().foreseen == pytest.approx(STOPS[1] - 0.01)
    assert "ends at most 9.74° from it is taken" in trial.warnings[0]


@pytest.mark.parametrize("strays", [1.1 * TARGET, float("inf")])
def test_a_fragile_plan_that_may_end_farther_off_than_now_is_not_taken(monkeypatch, strays):
    trial = Trial(monkeypatch, lambda target, tolerance: strays)
    with pytest.raises(TargetError, match="10 × fragile: it slips"):
        trial.prepare()


@pytest.mark.parametrize("fragile", [False, True])
def test_after_a_plan_that_hits_something_the_next_ones_keep_room(monkeypatch, fragile):
    trial, asked = Trial(monkeypatch, lambda target, tolerance: True), []

    def once(_session, _belief, _number, _s, _view, one):
        asked.append(one.apart)
        if len(asked) == 1:
            raise TargetError("no way")
        if len(asked) == 2 and not fragile:
            raise MotionHitsError("finger against plate")
        hit = len(asked) == 2
        delivery = SimpleNamespace(fragile="it touches" if hit else None, hits=hit, strays=float("inf"))
        return SimpleNamespace(foreseen=TARGET, delivery=delivery)

    monkeypatch.setattr(prepare, "planned_once", once)
    trial.prepare()
    assert asked == [False, False, True]


def test_reasons_that_differ_in_figures_only_are_one():
    told = grouped(
        ["ends -0.3 away", "fragile at 35 %", "ends 0.21 away", "fragile at 40 %", "fragile at 41.5 %"]
    )
    assert told == "3 × fragile at 35 %; 2 × ends -0.3 away"
    assert grouped(["no place"]) == "no place"
    assert grouped(["a", "b", "c", "d", "d", "e"]) == "2 × d; 1 × a; 1 × b; 2 × something else"


def test_small_actions_are_for_the_tries_after_quick_ones():
    tries = prepare._on_target(TARGET, careful=False)
    assert [one.turn_steps for one in tries[:3]] == [None, None, prepare.TURN_STEPS]
    assert tries[0] == Try(0, TARGET, 1.0)


def test_a_correction_is_not_made_at_any_price(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: False)
    with pytest.raises(TargetError):
        trial.prepare(s_initial=TARGET - 0.5 * FAUCET.tolerance, number=2)
    assert trial.asked == [(TARGET, doubt, None) for doubt in prepare.CORRECTION_DOUBTS]


def test_a_correction_is_made_with_a_fragile_plan_that_cannot_spoil_it(monkeypatch):
    to_go = 0.5 * FAUCET.tolerance
    trial = Trial(monkeypatch, lambda target, tolerance: 0.9 * to_go)
    assert trial.prepare(s_initial=TARGET - to_go, number=2).delivery.fragile
    assert len(trial.asked) == len(prepare.CORRECTION_DOUBTS)
