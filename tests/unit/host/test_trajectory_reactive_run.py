"""How motions follow one another in reactive mode: an executor, a planner and a clock of the test's own."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.errors import ArmStoppedError, CommandRefusedError, PeerUnreachableError
from s2r_host.link_types import TickWatch, Verdict
from s2r_host.trajectory import reactive_run
from s2r_host.trajectory.reactive import Outlook, ReactiveSettings
from s2r_host.trajectory.reactive_run import Seen, follow_reactively
from s2r_host.trajectory.trajectory import Trajectory
from s2r_protocol.faults import Cause, ExecutorState, Refusal

TICK_S = 0.002


def motion(duration_s):
    return Trajectory(np.array([0.0, duration_s]), *(np.zeros((2, 1)) for _ in range(3)))


class Clock:
    """Time that passes only when somebody sleeps or asks."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(reactive_run.time, "monotonic", self._tick)
        monkeypatch.setattr(reactive_run.time, "sleep", self._sleep)

    def _tick(self):
        self.now += TICK_S
        return self.now

    def _sleep(self, seconds):
        self.now += max(0.0, seconds)


class Executor:
    """Plays plans in the clock's time; splices what comes in time, refuses or forgets what it is told to."""

    def __init__(self, clock):
        self.clock, self.plans, self.refuse, self.forget = clock, [], [], []
        self.seq, self.epoch, self.labels = 0, 1, []
        self.heartbeat_ended, self.stands_at_s = False, math.inf

    def require_heartbeat(self):
        if self.heartbeat_ended:
            raise PeerUnreachableError("the heartbeat has ended")

    def watch(self, what):
        return TickWatch("this executor", what, 5.0, None)

    def send_plan(self, path, label, running=None, splice_t=0.0):
        self.labels.append(label)
        if self.refuse and (code := self.refuse.pop(0)) is not None:
            raise CommandRefusedError("not this one", code)
        self.seq += 1
        if running is None:
            begin = self.clock.now
        else:
            begin = next(b for s, b, _ in self.plans if s == running.seq) + splice_t
        if not (self.forget and self.forget.pop(0)):
            self.plans.append((self.seq, begin, path.duration_s))
        return Verdict(self.seq, self.epoch, path.duration_s)

    def status(self):
        now_s = min(self.clock.now, self.stands_at_s)
        begun = [plan for plan in self.plans if plan[1] <= now_s]
        seq, begin, duration = begun[-1]
        done = now_s - begin >= duration
        return SimpleNamespace(
            state=ExecutorState.HOLD if done else ExecutorState.RUN,
            plan_seq=seq,
            plan_t=min(now_s - begin, duration),
            plan_done=done,
            epoch=self.epoch,
            tick=round(now_s / TICK_S),
            cause=Cause(0),
            why_not_moving="",
        )


class Planner:
    """Offers what it was given to offer, one per look; None: the running motion is good."""

    def __init__(self, *offers):
        self.settings, self.offers = ReactiveSettings(), list(offers)
        self.seen, self.accepted, self.leads = [], 0, []

    def begin(self, first):
        self.first = first

    def accept(self, outlook):
        self.accepted += 1

    def look(self, running, t_now, s_live, lead_s, t_seen, half90):
        self.seen.append((running, t_now, s_live, t_seen))
        self.leads.append(lead_s)
        offer = self.offers.pop(0) if self.offers else None
        splice_t = min(t_now + lead_s, running.duration_s)
        return Outlook(0.1, offer, splice_t, 0.1, 0.0, np.zeros(1), 0.01, 0.01)


class Always:
    """A feed that shows the object whenever it is asked."""

    def latest(self):
        return Seen(0.05)


@pytest.fixture
def executor(monkeypatch):
    return Executor(Clock(monkeypatch))


def test_a_good_motion_is_looked_at_six_times_a_second_and_left_alone(executor):
    planner = Planner()
    report = follow_reactively(executor, Always(), planner, motion(2.0))
    assert (report.spliced, report.restarted, len(report.played)) == (0, 0, 1)
    assert report.rate_hz == pytest.approx(6.0, rel=0.05)
    assert planner.seen[-1][1] == 2.0  # the last look is at the end
    assert report.final == 0.05


def test_a_continuation_takes_over_the_running_motion(executor):
    better = motion(1.0)
    planner = Planner(None, better)
    report = follow_reactively(executor, Always(), planner, motion(2.0), label="m")
    assert (report.spliced, report.restarted, planner.accepted) == (1, 0, 1)
    assert executor.labels == ["m", "m: look 2"]
    assert planner.seen[-1][0] is better
    assert report.played[1][2] == pytest.approx(planner.seen[1][1] + 0.15)


def test_what_is_refused_as_late_leaves_the_motion_and_gives_the_next_more_time(executor):
    executor.refuse = [None, Refusal.LATE, None]
    planner = Planner(motion(1.0), motion(1.0))
    report = follow_reactively(executor, Always(), planner, motion(2.0))
    assert (report.spliced, report.refused, planner.accepted) == (1, ["not this one"], 1)
    assert planner.leads[:2] == pytest.approx([0.15, 0.225])


def test_a_short_end_is_followed_by_a_few_motions_from_rest(executor):
    class NeverThere(Planner):
        def look(self, running, t_now, *more):
            self.offers = [motion(0.4) if t_now >= running.duration_s else None]
            return super().look(running, t_now, *more)

    report = follow_reactively(executor, Always(), NeverThere(), motion(0.3), restarts=2)
    assert report.restarted == 2
    assert [m.duration_s for m, _, _ in report.played] == [0.3, 0.4, 0.4]


def test_refusals_at_rest_come_to_an_end(executor):
    executor.refuse = [None, *[Refusal.VELOCITY] * 50]
    planner = Planner(None, *[motion(0.4)] * 60)
    report = follow_reactively(executor, Always(), planner, motion(0.1), restarts=3)
    assert report.restarted == 0
    assert 3 <= len(report.refused) < 10


def test_an_admitted_continuation_that_never_begins_is_given_up(executor):
    executor.forget, told = [False, True], []
    report = follow_reactively(
        executor, Always(), Planner(motion(1.0)), motion(1.0),
        sent=lambda *_: told.append("sent"), given_up=lambda: told.append("given up"),
    )  # fmt: skip
    assert "did not take over" in report.refused[0]
    assert len(report.played) == 1
    assert report.spliced == 0
    assert told == ["sent", "sent", "given up"]


def test_at_rest_only_a_look_from_after_the_motion_counts(executor):
    class Slow:
        """Every frame is half a second old."""

        def latest(self):
            status = executor.status()
            t = executor.clock.now - 0.5 - next(b for s, b, _ in executor.plans if s == status.plan_seq)
            return Seen(0.05, 0.001, status.plan_seq, min(t, status.plan_t)) if t > 0.0 else None

    planner = Planner()
    report = follow_reactively(executor, Slow(), planner, motion(1.0))
    assert planner.seen[-1][3] == pytest.approx(1.0)
    assert all(t_seen <= t_now for _, t_now, _, t_seen in planner.seen)
    assert 1.5 < report.duration_s < 2.0
    assert report.unseen > 0


def test_an_object_that_is_never_seen_leaves_the_plan_as_it_is(executor):
    planner = Planner(motion(1.0))
    report = follow_reactively(executor, SimpleNamespace(latest=lambda: None), planner, motion(1.0))
    assert not planner.seen
    assert report.final is None
    assert report.rate_hz is None
    assert report.duration_s < 10.0


def test_a_look_at_another_plan_does_not_count(executor):
    planner = Planner()
    feed = SimpleNamespace(latest=lambda: Seen(0.05, 0.0, 99, 0.5))
    report = follow_reactively(executor, feed, planner, motion(1.0))
    assert not planner.seen
    assert report.unseen > 0


def test_a_stop_ends_it(executor):
    class Stopping(Always):
        def latest(self):
            executor.epoch += 1
            executor.status = lambda: SimpleNamespace(
                state=ExecutorState.FAULT, epoch=executor.epoch, cause=Cause.COLLISION, plan_seq=1, plan_t=0.1,
                plan_done=False, why_not_moving="contact",
            )  # fmt: skip
            return super().latest()

    with pytest.raises(ArmStoppedError):
        follow_reactively(executor, Stopping(), Planner(), motion(1.0))


@pytest.mark.parametrize("offers", [[], [motion(1.0)]], ids=["playing", "about to be corrected"])
def test_a_clock_that_stands_still_is_noticed(executor, offers):
    """Such an arm never comes to rest, and no continuation ever takes over."""
    executor.stands_at_s = 0.1
    with pytest.raises(
        PeerUnreachableError, match=r"at tick \d+ for 5 s while waiting for the end of 'push'"
    ):
        follow_reactively(executor, Always(), Planner(*offers), motion(1.0), label="push")
    assert executor.clock.now < 6.0


def test_a_heartbeat_that_ends_is_noticed(executor):
    class Ending(Always):
        def latest(self):
            executor.heartbeat_ended = True
            return super().latest()

    with pytest.raises(PeerUnreachableError, match="heartbeat"):
        follow_reactively(executor, Ending(), Planner(), motion(1.0))
    assert executor.clock.now < 1.0
