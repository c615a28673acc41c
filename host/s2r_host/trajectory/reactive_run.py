"""A motion on the executor that is corrected while it runs: live state in, spliced plans out."""

from __future__ import annotations

import logging
import time
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
_LEAD_GROWTH, _LEAD_MOST_S = 1.5, 1.0


class ObjectFeed(Protocol):
    """Where the live state of the object comes from, e.g. a tracker on depth frames."""

    def latest(self) -> float | None:
        """The object's joint now [m or rad]; None when it is not seen."""
        ...


@dataclass
class ReactiveReport:
    """What happened.

    Attributes:
        final: The object's joint at the end, as the feed has it, or None when it was not seen.
        outlooks: Every look at the future, in order.
        spliced: Continuations that were admitted while a motion ran.
        restarted: Continuations that were admitted after the last motion had ended.
        refused: The executor's sentences about those that were not; the last admitted plan went on.
        unseen: Looks that were left out because the object was not seen.
        duration_s: Wall time from the first plan to the end.
    """

    final: float | None = None
    outlooks: list[Outlook] = field(default_factory=list)
    spliced: int = 0
    restarted: int = 0
    refused: list[str] = field(default_factory=list)
    unseen: int = 0
    duration_s: float = 0.0


@dataclass(frozen=True, eq=False)
class _Plan:
    motion: Trajectory
    verdict: Verdict


def follow_reactively(
    link: ExecutorLink, feed: ObjectFeed, planner: ReactivePlanner, first: Trajectory, restarts: int = 3
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

    Raises:
        CommandRefusedError: The first plan was refused.
        ArmStoppedError: A protection or a person stopped the arm.
        PeerUnreachableError: The executor fell silent.
    """
    began_s, report = time.monotonic(), ReactiveReport()
    plan, coming = _Plan(first, link.send_plan(first, "reactive 0")), None
    planner.begin(first)
    lead_s = planner.settings.lead_s
    while True:
        due_s = time.monotonic() + 1.0 / planner.settings.rate_hz
        status = link.status()
        _check_going(status, (coming or plan).verdict)
        if coming is not None and status.plan_seq == coming.verdict.seq:
            plan, coming = coming, None
        if coming is not None or status.plan_seq != plan.verdict.seq:
            time.sleep(_POLL_S)
            continue
        resting = status.plan_done and status.state == ExecutorState.HOLD
        s_live = feed.latest()
        if s_live is None:
            report.unseen += 1
            if resting:
                break
            _sleep_until(due_s)
            continue
        outlook = planner.look(plan.motion, status.plan_t, s_live, lead_s)
        report.outlooks.append(outlook)
        if outlook.motion is None or (resting and report.restarted >= restarts):
            if resting:
                break
            _sleep_until(due_s)
            continue
        try:
            label = f"reactive {len(report.outlooks)}"
            if resting:
                plan = _Plan(outlook.motion, link.send_plan(outlook.motion, label))
                report.restarted += 1
            else:
                verdict = link.send_plan(
                    outlook.motion, label, running=plan.verdict, splice_t=outlook.splice_t
                )
                coming = _Plan(outlook.motion, verdict)
                report.spliced += 1
            planner.accept(outlook)
        except CommandRefusedError as error:
            report.refused.append(str(error))
            logger.info("the running plan goes on: %s", error)
            if error.code == Refusal.LATE:
                lead_s = min(_LEAD_GROWTH * lead_s, _LEAD_MOST_S)
            continue
        _sleep_until(due_s)
    report.final, report.duration_s = feed.latest(), time.monotonic() - began_s
    return report


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
