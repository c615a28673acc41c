"""A manipulation that was corrected on its way and then stopped."""

import math
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.errors import ArmStoppedError, NoMotionError
from s2r_host.link import Verdict
from s2r_host.run import back_off, reactive
from s2r_host.run.end import End
from s2r_host.run.planned import PlannedManipulation
from s2r_host.run.reactive import StrandedError
from s2r_host.run.session import Motion
from s2r_host.trajectory import Trajectory
from s2r_host.trajectory.reactive_run import ReactiveReport
from s2r_protocol.faults import Cause

NOT_USED: Any = None


class Feed(nullcontext):
    """Eyes on the part, which see nothing here."""

    def __init__(self, known=True, problem=""):
        super().__init__()
        self.known, self.problem = known, problem


def straight(q_from, q_to, duration_s=1.0) -> Trajectory:
    """From joint posture to joint posture [rad], each (7,)."""
    still = np.zeros((11, 7))
    return Trajectory(np.linspace(0.0, duration_s, 11), np.linspace(q_from, q_to, 11), still, still)


STAYING = straight(np.zeros(7), np.zeros(7))


def planned(trajectory: Trajectory) -> PlannedManipulation:
    request: Any = SimpleNamespace(s_initial=0.0)
    result: Any = SimpleNamespace(hook=None)
    motions, end = (Motion(trajectory, "manipulation 1"),), End("front", np.zeros(3), 0.002, touching=True)
    return PlannedManipulation(1, request, result, NOT_USED, NOT_USED, motions, end)


def carried_out(
    monkeypatch, follow, executed=(), first=STAYING, backed_off=lambda *_: None, feed=None, warned=None
) -> tuple[PlannedManipulation, list]:
    """What comes of a manipulation that is followed like this, and the motions whose recordings are kept."""
    sent: list = []
    warnings = [] if warned is None else warned

    def play(commands):
        commands(sent)
        session.executed += executed

    session: Any = SimpleNamespace(
        executed=[], link=None, play=play, journal=SimpleNamespace(elapsed_s=0.0, warn=warnings.append),
        status=lambda: SimpleNamespace(tick=0),
        note_sent=lambda motion, verdict, tick: SimpleNamespace(seq=verdict.seq, begun_s=0.0, wall_s=0.0),
    )  # fmt: skip
    monkeypatch.setattr(reactive, "scene_of", lambda _request: None)
    monkeypatch.setattr(reactive, "ReactivePlanner", lambda *_, yields: SimpleNamespace(yields=yields))
    monkeypatch.setattr(reactive, "LiveJoint", lambda *_: feed or Feed())
    monkeypatch.setattr(reactive, "follow_reactively", follow)
    monkeypatch.setattr(reactive, "back_off", backed_off)
    return reactive.carry_out_reactively(session, NOT_USED, planned(first), NOT_USED)[0], sent


@pytest.mark.parametrize("corrections", [0, 1])
def test_a_stopped_motion_is_known_to_be_corrected_where_another_had_taken_over(monkeypatch, corrections):
    """Else all of the part's way is taken for what the first motion made of it."""

    def follow(_link, _feed, _planner, first, label, sent, given_up):
        for k in range(1 + corrections):
            sent(first, label, Verdict(k, 0, 1.0), math.inf)
        raise ArmStoppedError("met something", Cause.COLLISION)

    done, _ = carried_out(monkeypatch, follow)
    assert done.stopped
    assert done.corrected == (corrections > 0)


def test_a_continuation_that_never_took_over_is_none_of_the_motions(monkeypatch):
    def follow(_link, _feed, _planner, first, label, sent, given_up):
        sent(first, label, Verdict(1, 0, 1.0), math.inf)
        sent(first, label, Verdict(2, 0, 1.0), 0.5)
        given_up()
        raise ArmStoppedError("met something", Cause.COLLISION)

    done, sent = carried_out(monkeypatch, follow)
    assert done.stopped
    assert not done.corrected
    assert [entry.seq for entry in sent] == [1]


def test_a_part_that_cannot_be_followed_is_moved_unseen_and_that_is_said_once(monkeypatch):
    warned: list[str] = []

    def follow(_link, _feed, _planner, first, label, sent, given_up):
        sent(first, label, Verdict(1, 0, 1.0), math.inf)
        raise ArmStoppedError("met something", Cause.COLLISION)

    _, sent = carried_out(monkeypatch, follow, feed=Feed(known=False, problem="40 points"), warned=warned)
    assert [entry.seq for entry in sent] == [1]
    assert warned == [
        "the part cannot be followed from the view before it moves (40 points): the plan is played unseen"
    ]


def test_the_planner_is_told_what_the_servos_of_the_plan_lack(monkeypatch):
    """The plan ends that much short of the target in the model, on purpose."""
    told = []

    def follow(_link, _feed, planner, first, label, sent, given_up):
        told.append(planner.yields)
        raise ArmStoppedError("met something", Cause.COLLISION)

    carried_out(monkeypatch, follow)
    assert told == [0.002]


FAR_IN, ASIDE = np.array([1.0, 0, 0, 0, 0, 0, 0]), np.array([0, 0.1, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("splice_t", "furthest"), [(0.43, 0.43), (math.inf, 1.0)], ids=["on the way", "from rest"]
)
def test_the_way_back_leads_past_what_was_played_and_nothing_else(monkeypatch, splice_t, furthest):
    """What lay behind a splice leads on into what the arm was stopped by."""
    first = straight(np.zeros(7), FAR_IN)
    correction = straight(furthest * FAR_IN, furthest * FAR_IN + ASIDE)
    q_stopped, ways_back = correction.sample(0.8)[0], []

    def follow(_link, _feed, _planner, first, label, sent, given_up):
        sent(first, label, Verdict(1, 0, 1.0), math.inf)
        sent(correction, label, Verdict(2, 0, 1.0), splice_t)
        raise ArmStoppedError("met something", Cause.COLLISION)

    def backed_off(_session, error, way_in, label):
        cell: Any = SimpleNamespace(
            status=lambda: SimpleNamespace(q_ref=q_stopped),
            settings=SimpleNamespace(acknowledge_contact=True),
            journal=SimpleNamespace(warn=lambda _text: None),
            link=SimpleNamespace(
                wait_at_rest=lambda: None, leased=nullcontext, reset=lambda: None, arm_drives=lambda: None
            ),
        )
        monkeypatch.setattr(back_off, "_play", lambda _cell, q, _label: ways_back.append(q))
        back_off.back_off(cell, error, way_in, label)

    carried_out(monkeypatch, follow, first=first, backed_off=backed_off)
    (way_back,) = ways_back
    assert way_back[0] == pytest.approx(q_stopped)
    assert way_back[-1] == pytest.approx(first.q[0])
    assert way_back[:, 0].max() == pytest.approx(furthest)
    assert (np.diff(way_back[:, 0]) < 1e-9).all()


def test_a_corrected_motion_from_whose_end_there_is_no_way_home_is_handed_over(monkeypatch):
    """It went through: what it did is to be measured."""

    def follow(_link, _feed, _planner, first, label, sent, given_up):
        sent(first, label, Verdict(1, 0, 1.0), math.inf)
        sent(first, label, Verdict(2, 0, 1.0), 0.5)
        return ReactiveReport()

    def blocked(*_):
        raise NoMotionError("no way out of contact")

    monkeypatch.setattr(reactive, "_tell", lambda *_: None)
    monkeypatch.setattr(reactive, "_as_played", lambda planned, _report: replace(planned, corrected=True))
    monkeypatch.setattr(reactive, "_other_way_home", blocked)
    with pytest.raises(StrandedError, match="no way out of contact; the arm is at rest where") as raised:
        carried_out(monkeypatch, follow, ("first", "second"))
    assert raised.value.planned.corrected
    assert raised.value.executed == ("first", "second")
