"""What a replay sends before the plan: nothing goes to the middle of a plan but the plan itself."""

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.errors import RecordingError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.recording import JointTrack
from s2r_host.replay.replay import ReplaySettings, replay_plan
from s2r_host.replay.sources import Replayable
from s2r_host.replay.way import JOINED_RAD
from s2r_host.trajectory import TimeLawSettings, Trajectory, time_law
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
HOME = np.asarray(ARM.q_home)
BESIDE = HOME + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


class PlansOnly(Exception):
    """Ends a replay where its plan has been sent: what follows reads a recording."""


class Link:
    """Takes every motion and stands at its end."""

    def __init__(self, q: np.ndarray) -> None:
        self.q, self.sent = np.asarray(q), []

    def leased(self) -> Any:
        return nullcontext()

    def arm_drives(self) -> None: ...

    def status(self) -> Any:
        return SimpleNamespace(q_ref=self.q)

    def send_plan(self, motion: Trajectory, label: str) -> Any:
        assert np.abs(motion.q[0] - self.q).max() <= JOINED_RAD, label
        self.sent.append((label, motion))
        self.q = motion.q[-1]
        if label.startswith("replay of"):
            raise PlansOnly
        return SimpleNamespace(seq=len(self.sent))

    def wait_done(self, verdict: Any) -> None: ...


def bent(q_from: np.ndarray, q_to: np.ndarray) -> Trajectory:
    """A way that no straight line replaces."""
    aside = np.array([0.0, 0.2, 0.0, -0.2, 0.0, 0.0, 0.0])
    share = np.linspace(0.0, 1.0, 21)[:, None]
    path = q_from + share * (q_to - q_from) + np.sin(np.pi * share) * aside
    return time_law(path, ARM, TimeLawSettings(speed=0.5))


def plan(number: int, trajectory: Trajectory, cut_s: float | None = None) -> Replayable:
    rest = np.zeros((2, ARM.dof))
    track = JointTrack(np.array([0, 1]), trajectory.q[[0, -1]], rest, np.zeros(2))
    return Replayable(number, f"plan {number}", trajectory, track, cut_s)


def sent_by(link: Link, *args: Any, **kwargs: Any) -> list[str]:
    with pytest.raises(PlansOnly):
        replay_plan(link, ArmModel(ARM), *args, **kwargs)  # type: ignore[arg-type]
    return [label for label, _ in link.sent]


@pytest.mark.parametrize("q", [HOME, BESIDE + 0.1])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_the_middle_of_a_plan_is_reached_along_the_plan_alone(q, share):
    motion = bent(BESIDE, HOME)
    t_start = share * motion.duration_s
    link = Link(q)
    labels = sent_by(link, plan(2, motion), ReplaySettings(t_start=t_start))
    assert labels[-2:] == [f"replay: 'plan 2' up to {t_start:g} s", "replay of 'plan 2'"]
    lead_in = link.sent[-2][1]
    np.testing.assert_allclose(lead_in.q[0], motion.q[0])
    played = lead_in.sample(np.linspace(0.0, lead_in.duration_s, 200))[0]
    recorded = motion.sample(np.linspace(0.0, t_start, 2000))[0]
    assert max(np.abs(recorded - q).max(axis=1).min() for q in played) < 1e-3
    assert not lead_in.dq[[0, -1]].any()
    assert (lead_in.peak(1) <= 0.5001 * motion.peak(1)).all()
    assert (lead_in.peak(2) <= ARM.limits.ddq_max).all()


def test_so_it_is_behind_the_recorded_way_in_a_world_as_it_was_found():
    plans = [plan(1, bent(HOME, BESIDE)), plan(2, bent(BESIDE, HOME))]
    labels = sent_by(Link(HOME), plans[1], ReplaySettings(t_start=0.5), plans=plans, as_found=True)
    assert labels == ["replay: 'plan 1' on the way", "replay: 'plan 2' up to 0.5 s", "replay of 'plan 2'"]


def test_an_arm_that_stands_there_already_does_not_go_back():
    """As it does after a stop: the part that is moved is where the plan had it then."""
    motion = bent(BESIDE, HOME)
    plans = [plan(1, bent(HOME, BESIDE)), plan(2, motion)]
    link = Link(motion.sample(0.7)[0])
    assert sent_by(link, plans[1], ReplaySettings(t_start=0.7), plans=plans) == ["replay of 'plan 2'"]


def test_a_begin_at_which_nothing_has_moved_yet_is_the_start():
    motion = bent(BESIDE, HOME)
    link = Link(BESIDE)
    labels = sent_by(link, plan(2, motion), ReplaySettings(t_start=1e-3), as_found=True)
    assert labels == ["replay of 'plan 2'"]


def test_a_plan_on_the_way_that_a_stop_broke_off_is_refused_before_anything_moves():
    plans = [
        plan(1, bent(HOME, BESIDE)),
        plan(2, bent(BESIDE, HOME), cut_s=0.4),
        plan(3, bent(HOME, BESIDE)),
    ]
    link = Link(HOME)
    with pytest.raises(RecordingError, match="plan 2 'plan 2' was broken off by a stop"):
        replay_plan(link, ArmModel(ARM), plans[2], plans=plans, as_found=True)  # type: ignore[arg-type]
    assert link.sent == []
