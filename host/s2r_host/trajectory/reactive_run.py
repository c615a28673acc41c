"""A motion on the executor that is corrected while it runs: live state in, spliced plans out."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from s2r_host.errors import CommandRefusedError
from s2r_host.link import ExecutorLink, ExecutorStatus, Verdict
from s2r_host.link_types import LATCHED, MOVING, stop_error
from s2r_host.trajectory.reactive import Outlook, ReactivePlanner
from s2r_host.trajectory.trajectory import Trajectory
from s2r_protocol.faults import ExecutorState, Refusal

logger = logging.getLogger(__name__)

_POLL_S = 0.005
_UNSEEN_S = 5.0  # an arm at rest waits so long for a look at the object
_END_S = 0.002
_TAKE_OVER_S = 1.0  # an admitted continuation that has not begun so long after the motion's end will not
_LEAD_GROWTH, _LEAD_MOST_S = 1.5, 1.0


@dataclass(frozen=True)
class Seen:
    """The object's joint as it was seen.

    Attributes:
        value: Of the joint [m or rad].
        half90: Half its 90 % interval.
        plan_seq: The executor's number of the plan that played then; None: seen at the moment of asking.
        plan_t: That plan's time then [s].
    """

    value: float
    half90: float = 0.0
    plan_seq: int | None = None
    plan_t: float = 0.0


class ObjectFeed(Protocol):
    """Where the live state of the object comes from, e.g. a tracker on depth frames."""

    def latest(self) -> Seen | None:
        """What was seen last; None when the object is not seen."""
        ...


@dataclass
class ReactiveReport:
    """What happened.

    Attributes:
        final: The object's joint at the end, as the feed has it, or None when it was not seen.
        outlooks: Every look at the future, in order.
        looked_s: When each of them began, since the first plan was sent [s].
        moving: Whether the arm moved then.
        played: The motions, each with the executor's number and when it took over from the one before, in that one's
            time [s]; infinite where it had come to rest.
        spliced: Continuations that were admitted while a motion ran, but for those that never took over.
        restarted: Continuations that were admitted after the last motion had ended.
        refused: The executor's sentences about those that were not; the last admitted plan went on.
        unseen: Looks that were left out because the object was not seen.
        duration_s: Wall time from the first plan to the end.
    """

    final: float | None = None
    outlooks: list[Outlook] = field(default_factory=list)
    looked_s: list[float] = field(default_factory=list)
    moving: list[bool] = field(default_factory=list)
    played: list[tuple[Trajectory, Verdict, float]] = field(default_factory=list)
    spliced: int = 0
    restarted: int = 0
    refused: list[str] = field(default_factory=list)
    unseen: int = 0
    duration_s: float = 0.0

    @property
    def rate_hz(self) -> float | None:
        """Looks per second of wall time while the arm moved; None with fewer than three."""
        times = [t for t, moving in zip(self.looked_s, self.moving, strict=True) if moving]
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 2 else None


@dataclass(frozen=True, eq=False)
class _Plan:
    motion: Trajectory
    verdict: Verdict


def follow_reactively(
    link: ExecutorLink,
    feed: ObjectFeed,
    planner: ReactivePlanner,
    first: Trajectory,
    restarts: int = 3,
    label: str = "reactive",
    sent: Callable[[Trajectory, str, Verdict, float], None] = lambda motion, label, verdict, splice_t: None,
    given_up: Callable[[], None] = lambda: None,
) -> ReactiveReport:
    """Play ``first`` and replace it by what the planner finds better, until the arm rests and nothing is better.

    The lease must be held and the drives enabled. Whatever is refused or comes too late, the last admitted plan goes
    on to its end, which was checked before it began.

    Args:
        link: To the executor.
        feed: Live state of the object.
        planner: Of the task that ``first`` was planned for.
        first: Begins where the arm is.
        restarts: Motions that may follow after the arm has come to rest.
        label: Of the plans.
        sent: Told of every plan that was admitted, and when it takes over from the one before, in that one's time [s];
            infinite where that one has come to rest.
        given_up: Told where the last of them never took over: the one before it was played to its end.

    Raises:
        CommandRefusedError: The first plan was refused.
        ArmStoppedError: A protection or a person stopped the arm.
        PeerUnreachableError: The executor fell silent, its clock stands still, or the heartbeat has ended.
    """
    following = _Following(link, feed, planner, restarts, label, sent, given_up, planner.settings.lead_s)
    following.play(first)
    return following.report


@dataclass
class _Following:
    """One run of `follow_reactively`, whose arguments begin it.

    Attributes:
        lead_s: How long before it takes over a continuation is sent [s]; longer after some that came too late.
        playing: What the executor plays.
        coming: What was admitted to take over from that and has not yet.
        rest_s: Since when the arm rests, on our monotonic clock; infinite while it moves.
        tries: Made to go on from rest, admitted or not.
        report: What happened so far.
        began_s: When the first plan was sent, on our monotonic clock.
    """

    link: ExecutorLink
    feed: ObjectFeed
    planner: ReactivePlanner
    restarts: int
    label: str
    sent: Callable[[Trajectory, str, Verdict, float], None]
    given_up: Callable[[], None]
    lead_s: float
    playing: _Plan = field(init=False)
    coming: _Plan | None = None
    rest_s: float = math.inf
    tries: int = 0
    report: ReactiveReport = field(default_factory=ReactiveReport)
    began_s: float = field(init=False)

    def play(self, first: Trajectory) -> None:
        """As `follow_reactively`."""
        self.began_s, report = time.monotonic(), self.report
        self.playing = self._send(first)
        self.planner.begin(first)
        watch = self.link.watch(f"the end of '{self.label}'")
        while True:
            due_s = time.monotonic() + 1.0 / self.planner.settings.rate_hz
            self.link.require_heartbeat()
            status = self.link.status()
            _check_going(status, (self.coming or self.playing).verdict)
            watch.check(status)
            resting = self._keep_up(status)
            if self.coming is not None or status.plan_seq != self.playing.verdict.seq:
                time.sleep(_POLL_S)
                continue
            seen = self.feed.latest()
            if seen is None or not _tells(seen, self.playing, resting=resting):
                if resting and time.monotonic() - self.rest_s > _UNSEEN_S:
                    break
                report.unseen += not resting
                _sleep_until(due_s)
                continue
            outlook = self._look(seen, status.plan_t, resting=resting)
            if outlook.motion is None or (resting and self.tries >= self.restarts):
                if resting:
                    break
            elif not self._take(outlook.motion, outlook, resting=resting):
                continue  # the next look is due at once: what was refused is no longer of use
            _sleep_until(due_s)
        last = self.feed.latest()
        report.final, report.duration_s = last.value if last else None, time.monotonic() - self.began_s

    def _keep_up(self, status: ExecutorStatus) -> bool:
        """Note which plan plays; a continuation that never took over is given up. Whether the arm rests."""
        if self.coming is not None and status.plan_seq == self.coming.verdict.seq:
            self.playing, self.coming = self.coming, None
        resting = status.plan_done and status.state == ExecutorState.HOLD
        self.rest_s = min(self.rest_s, time.monotonic()) if resting else math.inf
        if self.coming is not None and resting and time.monotonic() - self.rest_s > _TAKE_OVER_S:
            self.report.played.pop()
            self.report.spliced -= 1
            self.given_up()
            self.report.refused.append(f"plan {self.coming.verdict.seq} was admitted, but did not take over")
            self.coming = None
        return resting

    def _look(self, seen: Seen, plan_t: float, *, resting: bool) -> Outlook:
        self.report.looked_s.append(time.monotonic() - self.began_s)
        self.report.moving.append(not resting)
        t_seen = None if seen.plan_seq is None else seen.plan_t
        outlook = self.planner.look(self.playing.motion, plan_t, seen.value, self.lead_s, t_seen, seen.half90)
        self.report.outlooks.append(outlook)
        return outlook

    def _take(self, motion: Trajectory, outlook: Outlook, *, resting: bool) -> bool:
        """Send what the planner found better, to take over or, at rest, to begin anew; False if it was refused."""
        try:
            if resting:
                self.tries += 1
                self.playing, self.rest_s = self._send(motion), math.inf
                self.report.restarted += 1
            else:
                self.coming = self._send(motion, self.playing, outlook.splice_t)
                self.report.spliced += 1
        except CommandRefusedError as error:
            self.report.refused.append(str(error))
            logger.info("the running plan goes on: %s", error)
            if error.code == Refusal.LATE:
                self.lead_s = min(_LEAD_GROWTH * self.lead_s, _LEAD_MOST_S)
            return False
        self.planner.accept(outlook)
        return True

    def _send(self, motion: Trajectory, running: _Plan | None = None, splice_t: float = math.inf) -> _Plan:
        """Have a motion admitted: from rest, or as what takes over from ``running`` at its time ``splice_t`` [s]."""
        name = f"{self.label}: look {len(self.report.outlooks)}" if self.report.played else self.label
        if running is None:
            verdict = self.link.send_plan(motion, name)
        else:
            verdict = self.link.send_plan(motion, name, running=running.verdict, splice_t=splice_t)
        self.report.played.append((motion, verdict, splice_t))
        self.sent(motion, name, verdict, splice_t)
        return _Plan(motion, verdict)


def _tells(seen: Seen, plan: _Plan, *, resting: bool) -> bool:
    """Whether what was seen says where the object is with this plan; at rest it has to be of its end."""
    if seen.plan_seq is None:
        return True
    ended = seen.plan_t >= plan.motion.duration_s - _END_S
    return seen.plan_seq == plan.verdict.seq and (ended or not resting)


def _check_going(status: ExecutorStatus, verdict: Verdict) -> None:
    """Notice an arm that was stopped.

    Raises:
        ArmStoppedError: It was; every stop and latch begins a new epoch.
    """
    stopped = status.state not in MOVING and status.epoch != verdict.epoch
    if status.state in LATCHED or stopped:
        raise stop_error(status)


def _sleep_until(due_s: float) -> None:
    time.sleep(max(0.0, due_s - time.monotonic()))
