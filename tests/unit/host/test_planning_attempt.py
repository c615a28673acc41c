"""When an attempt ends without a plan, and what is tried next."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.planning import cascade
from s2r_host.planning.attempt import Attempt
from s2r_host.planning.patience import TimeIsUpError
from s2r_host.planning.rewards import Task
from s2r_host.planning.settings import PlanSettings, PlanSettingsError
from s2r_host.planning.task import PlanRefusedError, StepTrace
from s2r_host.trajectory import legs_search


def attempt_with(s, distance_m, settings=None):
    """An attempt at moving a hinge from 0 to 1 rad that has gone through these values."""
    attempt = Attempt.__new__(Attempt)
    attempt.task = Task(0.0, 1.0, 0.01, False)
    attempt.settings = settings or PlanSettings()
    attempt.trace = [
        StepTrace(0, k, float(a), float(d), 0.0, 0, 0.1, None)
        for k, (a, d) in enumerate(zip(s, distance_m, strict=True))
    ]
    return attempt


FUMBLING = 0.02 + 0.005 * np.sin(np.arange(30.0))  # the fingertip goes to and fro


def test_fumbling_beside_the_part_ends_an_attempt():
    assert attempt_with(np.zeros(30), FUMBLING)._is_stuck()
    assert not attempt_with(np.zeros(25), FUMBLING[:25])._is_stuck()


def test_a_part_that_moves_on_slowly_or_a_fingertip_that_comes_nearer_is_progress():
    assert not attempt_with(np.linspace(0.0, 0.03, 30), FUMBLING)._is_stuck()
    assert not attempt_with(np.zeros(30), np.linspace(0.1, 0.05, 30))._is_stuck()


def test_near_the_target_landing_takes_its_time():
    assert not attempt_with(np.full(30, 0.96), FUMBLING)._is_stuck()


def test_without_a_way_to_the_part_detours_are_allowed():
    assert not attempt_with(np.zeros(30), FUMBLING, replace(PlanSettings(), lead_in=False))._is_stuck()


def action_rad(way_rad, prismatic=False, **settings):
    """The largest action of an attempt whose arm goes so far with the part."""
    attempt = attempt_with(np.zeros(1), np.zeros(1), replace(PlanSettings(), **settings))
    attempt.scene = SimpleNamespace(prismatic=prismatic)
    route = np.zeros((6, 7))
    route[3:, 2] = np.array([0.3, 0.6, 1.0]) * way_rad  # row 2 is the touch
    attempt.hook = SimpleNamespace(whole_route=route, touch_row=2)
    return attempt._action_rad()


def test_a_hinges_part_is_turned_in_no_fewer_steps_than_is_wished():
    usual = PlanSettings().action_max_rad
    assert action_rad(0.24, turn_steps=24) == pytest.approx(0.01)
    assert action_rad(2.0, turn_steps=24) == usual
    assert (
        0.0 < action_rad(1e-4, turn_steps=24) == action_rad(1e-5, turn_steps=24)
    )  # the part is still to be reached
    assert action_rad(0.24) == usual
    assert action_rad(0.24, prismatic=True, turn_steps=24) == usual
    assert action_rad(0.24, lead_in=False, turn_steps=24) == usual


@pytest.mark.parametrize(("blocked", "tried"), [((), "a"), (("a",), "ab"), (("a", "b"), "abc")])
def test_a_place_that_the_arm_does_not_get_to_is_dropped_for_the_next_in_the_same_stage(
    monkeypatch, blocked, tried
):
    class Fake:
        def __init__(self, *, index, hook, **_):
            self.hook, self.index, self.arrived, self.reason = hook, index, hook not in blocked, "no"
            self.stuck = True

        def run(self):
            pass

    monkeypatch.setattr(cascade, "Attempt", Fake)
    request: Any = SimpleNamespace(settings=PlanSettings(), seed=0, leave=False)
    hooks: Any = list("abc")
    nothing: Any = None
    stages = cascade.Cascade(request, nothing, nothing, nothing, hooks, nothing, nothing)
    stages.try_stage(0, nothing)
    assert "".join(attempt.hook for attempt in stages.attempts) == tried  # type: ignore[arg-type]
    assert stages.hooks == [hook for hook in "abc" if hook not in blocked]
    assert {attempt.index for attempt in stages.attempts} == {0}


REQUEST: Any = SimpleNamespace(settings=PlanSettings())
FALLING: Any = SimpleNamespace(
    settings=PlanSettings()
)  # some slightly different part does not stay at its target


class Search:
    """Plans of legs by name; what they are worth is in ``WORTH``."""

    def __init__(self, *names):
        self.names, self.scene, self.problem, self.calm = names, None, None, None

    def only_calm(self, count, *, apart):
        self.calm = count

    def onward(self, *_, **__):
        for name in self.names:
            if name == "late":
                raise TimeIsUpError("too late")
            yield [name]


@pytest.fixture
def worth(monkeypatch):
    def together(_request, _scene, names):
        if names == ["lost"]:
            raise PlanRefusedError("the legs together: lost")
        share = 0.6 if names == ["hard"] else 0.1
        fragile = None if names == ["calm"] else f"fragile: {names[0]}"
        return SimpleNamespace(
            name=names[0],
            delivery=SimpleNamespace(
                fragile=fragile, hits=False, replay=SimpleNamespace(contact_share=share)
            ),
        )

    monkeypatch.setattr(legs_search, "together", together)
    monkeypatch.setattr(legs_search, "cannot_stay", lambda request, _scene: request is FALLING)


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (("calm", "first"), "calm"),
        (("first", "calm"), "calm"),
        (("lost", "first", "second"), "first"),
        (("first", "late"), "first"),
        (("hard", "calm"), "hard"),  # with the believed object: no other leg needs less force
    ],
)
def test_the_calmest_legs_are_delivered_else_the_first_that_hold(worth, names, chosen):
    search: Any = Search(*names)
    whole: Any = legs_search.calmest(search, REQUEST, slipped=False)
    assert whole.name == chosen
    assert (search.calm is not None) == ("first" in names and names[0] != "calm")


def test_no_calmer_legs_are_looked_for_where_the_part_would_not_stay_anyway(worth):
    search: Any = Search("first", "calm")
    whole: Any = legs_search.calmest(search, FALLING, slipped=False)
    assert whole.name == "first"
    assert search.calm is None


def test_without_legs_that_hold_the_reason_or_the_clock_remains(worth):
    search: Any = Search("lost")
    late: Any = Search("late")
    assert legs_search.calmest(search, REQUEST, slipped=False) is None
    assert search.problem == "the legs together: lost"
    with pytest.raises(TimeIsUpError):
        legs_search.calmest(late, REQUEST, slipped=False)


@pytest.mark.parametrize(
    ("name", "value"), [("retries", 0), ("backtracks", -1), ("hooks", 0), ("threads", -1), ("ensemble", 0)]
)
def test_counts_with_which_nothing_can_be_planned_are_refused_by_name(name, value):
    with pytest.raises(PlanSettingsError, match=name):
        replace(PlanSettings(), **{name: value})
