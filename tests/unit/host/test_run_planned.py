"""Which plans are tried for a manipulation, and what is taken when none ends on target."""

from types import SimpleNamespace
from typing import Any

import pytest

from s2r_host.errors import TargetError
from s2r_host.run import planned
from s2r_host.run.task import FAUCET

TARGET = 0.4
STOPS = [0.1, 0.25]
VIEW: Any = None


class Trial:
    """A stand-in for the planner that finds what `finds` says of target and tolerance."""

    def __init__(self, monkeypatch, finds):
        self.asked: list[tuple[float, float, float | None]] = []
        self.seeds: list[int] = []
        self.warnings: list[str] = []
        self._finds = finds
        monkeypatch.setattr(planned, "_prepare_once", self._once)
        monkeypatch.setattr(planned, "_stops", lambda *_: STOPS)

    def _once(self, _session, _belief, _number, _s, target, _view, attempt, doubt, tolerance=None):
        self.asked.append((target, doubt, tolerance))
        self.seeds.append(attempt)
        if not self._finds(target, tolerance):
            raise TargetError(f"no way to {target}")
        return SimpleNamespace(foreseen=target - 0.01)

    def prepare(self, s_initial=0.0, number=1):
        session: Any = SimpleNamespace(
            target=TARGET,
            settings=SimpleNamespace(task=FAUCET),
            journal=SimpleNamespace(warn=self.warnings.append),
        )
        belief: Any = None
        return planned.prepare_manipulation(session, belief, number, s_initial, VIEW, "{:.2f}".format)


def test_a_plan_that_ends_on_target_is_taken_without_a_word(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: True)
    trial.prepare()
    assert trial.asked == [(TARGET, 1.0, None)]
    assert not trial.warnings


def test_a_state_on_the_way_comes_before_one_beside_the_target(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: target < TARGET)
    assert trial.prepare().foreseen == pytest.approx(STOPS[0] - 0.01)
    assert len(trial.asked) == len(planned.DOUBTS) + 1
    assert "no way to 0.4" in trial.warnings[0]
    assert "first to 0.09" in trial.warnings[0]


def test_beside_the_target_is_better_than_nothing(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: tolerance is not None)
    assert trial.prepare().foreseen == pytest.approx(TARGET - 0.01)
    target, doubt, tolerance = trial.asked[-1]
    assert (target, doubt) == (TARGET, planned.STOP_DOUBTS[0])
    assert tolerance == pytest.approx(planned.ROUGHLY * TARGET)
    assert len(set(trial.seeds)) == len(trial.seeds)


def test_when_nothing_is_found_the_first_reason_is_told(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: False)
    with pytest.raises(TargetError, match=r"from 0.00 to 0.40 \(10 tries\): no way to 0.4; try another"):
        trial.prepare()
    assert len(trial.asked) == len(planned.DOUBTS) + len(planned.STOP_DOUBTS) * (len(STOPS) + 1)


def test_a_correction_is_not_made_at_any_price(monkeypatch):
    trial = Trial(monkeypatch, lambda target, tolerance: False)
    with pytest.raises(TargetError):
        trial.prepare(s_initial=TARGET - 0.5 * FAUCET.tolerance, number=2)
    assert trial.asked == [(TARGET, doubt, None) for doubt in planned.CORRECTION_DOUBTS]
