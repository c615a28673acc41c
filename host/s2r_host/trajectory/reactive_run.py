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
        spliced: Continuations that were admitted while a motion ran.
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
    sent: Callable[[Trajectory, str, Verdict], None] = lambda motion, label, verdict: None,
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
        sent: Told of every plan that was admitted.

    Raises:
        CommandRefusedError: The first plan was refused.
        ArmStoppedError: A protection or a person stopped the arm.
        PeerUnreachableError: The executor fell silent.
    """
    began_s, report = time.monotonic(), ReactiveReport()

    def admitted(motion: Trajectory, running: _Plan | None = None, splice_t: float = math.inf) -> _Plan:
        name = f"{label}: look {len(report.outlooks)}" if report.played else label
        if running is None:
            verdict = link.send_plan(motion, name)
        else:
            verdict = link.send_plan(motion, name, running=running.verdict, splice_t=splice_t)
        report.played.append((motion, verdict, splice_t))
        sent(motion, name, verdict)
        return _Plan(motion, verdict)

    plan = admitted(first)
    coming: _Plan | None = None
    planner.begin(first)
    lead_s, rest_s, tries = planner.settings.lead_s, math.inf, 0  # tries: to go on from rest
    while True:
        due_s = time.monotonic() + 1.0 / planner.settings.rate_hz
        status = link.status()
        _check_going(status, (coming or plan).verdict)
        if coming is not None and status.plan_seq == coming.verdict.seq:
            plan, coming = coming, None
        resting = status.plan_done and status.state == ExecutorState.HOLD
        rest_s = min(rest_s, time.monotonic()) if resting else math.inf
        if coming is not None and resting and time.monotonic() - rest_s > _TAKE_OVER_S:
            report.played.pop()
            report.refused.append(f"plan {coming.verdict.seq} was admitted, but did not take over")
            coming = None
        if coming is not None or status.plan_seq != plan.verdict.seq:
            time.sleep(_POLL_S)
            continue
        seen = feed.latest()
        if seen is None or not _tells(seen, plan, resting=resting):
            if resting and time.monotonic() - rest_s > _UNSEEN_S:
                break
            report.unseen += not resting
            _sleep_until(due_s)
            continue
        report.looked_s.append(time.monotonic() - began_s)
        report.moving.append(not resting)
        t_seen = None if seen.plan_seq is None else seen.plan_t
        outlook = planner.look(plan.motion, status.plan_t, seen.value, lead_s, t_seen, seen.half90)
        report.outlooks.append(outlook)
        if outlook.motion is None or (resting and tries >= restarts):
            if resting:
                break
            _sleep_until(due_s)
            continue
        try:
            if resting:
                tries += 1
                plan, rest_s = admitted(outlook.motion), math.inf
                report.restarted += 1
            else:
                coming = admitted(outlook.motion, plan, outlook.splice_t)
                report.spliced += 1
            planner.accept(outlook)
        except CommandRefusedError as error:
            report.refused.append(str(error))
            logger.info("the running plan goes on: %s", error)
            if error.code == Refusal.LATE:
                lead_s = min(_LEAD_GROWTH * lead_s, _LEAD_MOST_S)
            continue
        _sleep_until(due_s)
    last = feed.latest()
    report.final, report.duration_s = last.value if last else None, time.monotonic() - began_s
    return report


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
