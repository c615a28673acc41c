"""After a contact that does not give way the arm goes back the way it came, and only then."""

from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.errors import ArmStoppedError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.run import first_push, manipulate
from s2r_host.run.back_off import back_off
from s2r_host.run.first_push import PlannedPush, carry_out_push
from s2r_host.run.manipulate import carry_out_manipulation
from s2r_host.run.planned import PlannedManipulation
from s2r_host.run.session import Motion
from s2r_protocol.arms import load_arm
from s2r_protocol.faults import Cause

NOT_USED: Any = None


class Cell:
    """Just enough of a session; ``did`` is what was asked of it, in order.

    ``jams`` motions are stopped, each after ``gain``; while ``hooked`` all are but one further in, which sets free.
    """

    def __init__(self, q_now, jams=0, gain=0.0):
        self.did, self.moved, self._q, self.jams, self.gain = [], [], q_now, jams, gain
        self.hooked = False
        self.arm = ArmModel(load_arm("xmate3pro"))
        self.settings = SimpleNamespace(push_speed=0.25, acknowledge_contact=True)
        self.journal = SimpleNamespace(warn=lambda text: self.did.append("warn"))
        self.link = SimpleNamespace(
            wait_at_rest=lambda: self.did.append("rest"),
            reset=lambda: self.did.append("reset"),
            arm_drives=self._arm_drives,
            leased=self._leased,
        )

    def _arm_drives(self):
        """The arm has sagged a little into its brakes, and the reference is taken up where it is."""
        self.did.append("arm")
        self._q = self._q - SAG

    @contextmanager
    def _leased(self):
        self.did.append("lease")
        yield
        self.did.append("lease back")

    def status(self):
        return SimpleNamespace(q_ref=self._q)

    def move(self, motions):
        self.did.append("move")
        self.moved += motions
        end = motions[0].trajectory.q[-1]
        if self.hooked and np.abs(end - WAY[-1]).max() < np.abs(self._q - WAY[-1]).max():
            self.hooked, self._q = False, end
            return
        if self.jams or self.hooked:
            self.jams = max(self.jams - 1, 0)
            self._q = self._q - self.gain
            raise ArmStoppedError("met something again", Cause.COLLISION)


HOME = load_arm("xmate3pro").q_home
SAG = 5e-4
LABELS = ("back", "back, giving way first")
WAY = HOME + np.linspace(0.0, 0.4, 21)[:, None] * np.array([1.0, 0.5, 0, 0, 0, 0, 0])


def test_the_arm_goes_back_along_its_way_to_the_beginning():
    cell = Cell(WAY[12] + 0.004)
    back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")
    assert cell.did == ["rest", "warn", "lease", "reset", "arm", "lease back", "move"]
    q = cell.moved[0].trajectory.q
    assert np.allclose(q[0], WAY[12] + 0.004 - SAG, atol=1e-6)
    assert np.allclose(q[-1], WAY[0], atol=1e-6)
    off = np.abs(q[:, None] - WAY[None]).max(axis=2).min(axis=1)
    assert off.max() < 0.03


def test_the_way_back_round_a_corner_leaves_the_way_in_by_less_than_a_millimetre():
    """A fingertip behind an edge has no room beside the way it came."""
    there = np.linspace(0.0, 0.15, 61)[:, None]
    first, then = np.array([0, 0.5, 0, 1.0, 0, 0.5, 0]), np.array([1.0, 0, 0.5, 0, 0, 0, 0])
    way = np.concatenate([HOME + there * first, HOME + there[-1] * first + there[1:] * then])
    cell = Cell(way[-1] + SAG)
    back_off(cell, ArmStoppedError("met something", Cause.COLLISION), way, "back")
    motion = cell.moved[0].trajectory
    played = motion.sample(np.linspace(0.0, motion.duration_s, 400))[0]
    p, p_in = (np.array([cell.arm.tool_pose(q)[:3, 3] for q in some]) for some in (played, way))
    a, b = p_in[:-1], p_in[1:]
    share = np.einsum("pni,ni->pn", p[:, None] - a, b - a) / ((b - a) ** 2).sum(axis=1)
    nearest = a + np.clip(share, 0.0, 1.0)[..., None] * (b - a)
    assert np.linalg.norm(p[:, None] - nearest, axis=2).min(axis=1).max() < 1e-3


def test_the_arm_that_has_not_moved_yet_stays():
    cell = Cell(WAY[0])
    back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")
    assert "reset" in cell.did
    assert "move" not in cell.did


@pytest.mark.parametrize(
    ("q", "cause"),
    [(WAY[5], Cause.STOP_REQUESTED), (WAY[5] + 0.2, Cause.COLLISION)],
    ids=["other cause", "elsewhere"],
)
def test_any_other_stop_is_left_to_an_operator(q, cause):
    cell, error = Cell(q), ArmStoppedError("stopped", cause)
    with pytest.raises(ArmStoppedError) as raised:
        back_off(cell, error, WAY, "back")
    assert raised.value is error
    assert cell.did == ["rest"]


def test_without_the_operators_word_beforehand_the_stop_stands():
    cell = Cell(WAY[12])
    cell.settings.acknowledge_contact = False
    with pytest.raises(ArmStoppedError):
        back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")
    assert cell.did == []


def test_a_jammed_fingertip_is_freed_in_several_tries():
    cell = Cell(WAY[12], jams=2)
    back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")
    assert cell.did.count("move") == 3


def test_a_fingertip_that_stays_jammed_is_left_to_an_operator():
    cell = Cell(WAY[12], jams=9)
    with pytest.raises(ArmStoppedError, match="again"):
        back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")
    back, further = (
        np.array([m.trajectory.q[-1] for m in cell.moved if m.label == label]) for label in LABELS
    )
    assert len(back) == 6
    assert np.allclose(back, WAY[0], atol=1e-6)
    assert len(further) == 1


def test_a_fingertip_held_from_behind_gives_way_once_before_it_goes_back():
    cell = Cell(WAY[12])
    cell.hooked = True
    back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")
    assert [motion.label for motion in cell.moved] == ["back"] * 3 + [LABELS[1], "back"]
    further, back = cell.moved[-2].trajectory.q, cell.moved[-1].trajectory.q
    assert 0.03 < np.abs(further[-1] - further[0]).max() < 0.06
    assert np.abs(further[-1] - WAY).max(axis=1).min() < 1e-6
    assert np.allclose(back[0], further[-1])
    assert np.allclose(back[-1], WAY[0], atol=1e-6)


def test_a_stop_of_another_cause_while_giving_way_is_left_to_an_operator():
    cell = Cell(WAY[12], jams=3)
    move = cell.move

    def stopped_by_hand(motions):
        if motions[0].label == LABELS[1]:
            raise ArmStoppedError("stopped by hand", Cause.STOP_REQUESTED)
        move(motions)

    cell.move = stopped_by_hand
    with pytest.raises(ArmStoppedError, match="by hand"):
        back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")


def test_at_the_end_of_the_way_in_there_is_nowhere_to_give_way_to():
    cell = Cell(WAY[-1], jams=9)
    with pytest.raises(ArmStoppedError, match="again"):
        back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")
    assert [motion.label for motion in cell.moved] == ["back"] * 3


def test_a_fingertip_that_comes_free_by_and_by_gets_more_tries():
    cell = Cell(WAY[12], jams=5, gain=0.01 * (WAY[1] - WAY[0]) / np.abs(WAY[1] - WAY[0]).max())
    back_off(cell, ArmStoppedError("met something", Cause.COLLISION), WAY, "back")
    assert cell.did.count("move") == 6


def stopped_at(label, labels):
    """A session that is stopped in the motion of that name, and the motions."""
    motions = tuple(Motion(SimpleNamespace(q=WAY), name) for name in labels)
    session: Any = SimpleNamespace(executed=[], status=lambda: SimpleNamespace(q_ref=WAY[0]))
    session.settings = SimpleNamespace(travel_speed=1.0)

    def move(some):
        for one in some:
            session.executed.append(one)
            if one.label == label:
                raise ArmStoppedError("met something", Cause.COLLISION)

    session.move = move
    return session, motions


@pytest.mark.parametrize(
    "label", ["manipulation 1", "manipulation 1: out of contact", "manipulation 1: home"]
)
def test_only_a_stop_in_the_manipulation_itself_is_backed_off_from(monkeypatch, label):
    """The way out of contact begins where the way in ends: near it is not on it."""
    labels = ("manipulation 1", "manipulation 1: out of contact", "manipulation 1: home")
    session, motions = stopped_at(label, labels)
    backed_off = []
    monkeypatch.setattr(manipulate, "back_off", lambda *arguments: backed_off.append(arguments))
    planned = PlannedManipulation(1, NOT_USED, NOT_USED, NOT_USED, NOT_USED, motions, NOT_USED)
    if label == "manipulation 1":
        done, executed = carry_out_manipulation(session, planned)
        assert done.stopped
        assert len(backed_off) == len(executed) == 1
        return
    with pytest.raises(ArmStoppedError):
        carry_out_manipulation(session, planned)
    assert not backed_off


@pytest.mark.parametrize("label", ["push 1: approach", "push 1", "push 1: back", "push 1: home"])
def test_only_a_stop_in_the_push_itself_is_backed_off_from(monkeypatch, label):
    session, motions = stopped_at(label, ("push 1: approach", "push 1", "push 1: back", "push 1: home"))
    backed_off = []
    monkeypatch.setattr(first_push, "back_off", lambda *arguments: backed_off.append(arguments))
    monkeypatch.setattr(first_push, "timed", lambda _session, way, *_: Motion(NOT_USED, "back home"))
    ways: Any = SimpleNamespace(approach=WAY, push=WAY)
    if label == "push 1":
        done = carry_out_push(session, PlannedPush(NOT_USED, ways, motions))
        assert not done.went_through
        assert len(backed_off) == 1
        return
    with pytest.raises(ArmStoppedError):
        carry_out_push(session, PlannedPush(NOT_USED, ways, motions))
    assert not backed_off
