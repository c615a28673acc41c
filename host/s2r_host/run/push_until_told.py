"""Push, look and estimate, until two of the views tell the joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.perception.errors import AbstainError, NothingMovedError
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.motion import Push
from s2r_host.run.belief import estimate_part, grown_usually
from s2r_host.run.first_push import DonePush, carry_out_push, prepare_push
from s2r_host.run.knob_watch import KnobWatch
from s2r_host.run.observe import Observation, observe, seen_to_move
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Session
from s2r_host.run.task import DRAWER, FAUCET, Task
from s2r_protocol.exits import RefusedError

ELSEWHERE_M = 0.08  # from one push to another: perhaps on another drawer


@dataclass(frozen=True, eq=False)
class Told:
    """What the pushes came to.

    Attributes:
        estimate: The joint.
        before: The view that its values count from: the first one, wherever that and the newest tell the joint.
        previous: The last view before the last push.
        after: The newest view.
    """

    estimate: JointEstimate
    before: Observation
    previous: Observation
    after: Observation

    @property
    def share(self) -> float:
        """Half the motion's 90 % interval over the motion."""
        low, high = self.estimate.intervals90.delta
        return 0.5 * (high - low) / max(abs(self.estimate.delta), 1e-9)


def push_until_told(session: Session, record: RunRecord, first: Observation) -> Told | None:
    """Push, look and estimate; where the views do not tell the joint, push again elsewhere. None in a dry run.

    The first view is compared with the newest: what several pushes moved adds up. Where that is too much to be
    followed, or the first view hides the part, one of the views in between may tell. A joint told vaguely is kept for
    when no further push is reachable or nothing moves any more.

    Raises:
        AbstainError: The last push told nothing either.
        NoMotionError: No further push is reachable.
    """
    settings, journal, task = session.settings, session.journal, session.settings.task
    views, skip = [first], 0
    knobs = KnobWatch(first) if task is FAUCET else None
    pushes: list[DonePush] = []
    positive: np.ndarray | None = None
    vague: tuple[Told, DonePush] | None = None
    for number in range(1, settings.pushes + 1):
        again = "" if number == 1 else f" {number}"
        with journal.stage(f"first push{again}: proposals") as stage:
            try:
                planned = prepare_push(
                    session, views[-1], number, skip, pushes, () if knobs is None else knobs.now
                )
            except RefusedError as error:
                if vague is None:
                    raise
                stage.note = f"the joint stays as vague as it was told: {error}"
                told, record.push = vague
                return told
            record.planned_push = planned
            skip += planned.motion.tried
            positive = planned.positive if positive is None else positive
            stage.note = f"proposal {skip} is reachable"
        if settings.dry_run:
            return None
        with journal.stage(f"first push{again}"):
            record.push = carry_out_push(session, planned)
            pushes.append(record.push)
        with journal.stage(f"view B{again}") as stage:
            views.append(record.add_view(observe(session, f"B{number if again else ''}")))
            stage.note = f"{len(views[-1].scene.p_base)} object points"
        if knobs is not None:
            knobs.look(views[-1])
        moved = seen_to_move(*views[-2:])
        if moved is not None:
            pushes[-1] = replace(pushes[-1], moved=moved, sure=True)
        try:
            with journal.stage(f"estimate joint{again}") as stage:
                knob = None if knobs is None else knobs.joint()
                before, estimate = (
                    _compared(session, views, pushes, positive)
                    if knob is None
                    else (first, grown_usually(knob))
                )
                seen = f", since view {before.name}" if before is not first else ""
                stage.note = f"moved {task.unit.show(estimate.delta)}{seen}, {100 * estimate.explained:.0f} % explained"
        except (AbstainError, SceneError) as error:
            if moved is None:
                pushes[-1] = replace(pushes[-1], moved=not isinstance(error, NothingMovedError))
            if pushes[-1].moved:
                vague = None  # the part is elsewhere by now
            if number == settings.pushes:
                if vague is None:
                    raise
                told, record.push = vague
                return told
            journal.warn(f"push {number} does not tell the joint, pushing again: {error}")
            continue
        for text in estimate.warnings:
            journal.warn(text)
        told = Told(estimate, before, views[-2], views[-1])
        if number == settings.pushes or told.share <= task.told_to:
            return told
        vague = told, pushes[-1]
        limit = f"{100 * task.told_to:.0f} % of a {task.part}'s is asked for"
        journal.warn(
            f"push {number} tells the motion to {100 * told.share:.0f} % only, {limit}, pushing again"
        )
    raise AssertionError("settings.pushes is at least 1")


def _compared(
    session: Session, views: Sequence[Observation], pushes: Sequence[DonePush], positive: np.ndarray | None
) -> tuple[Observation, JointEstimate]:
    """The joint by the newest view and an earlier one, and that one.

    Args:
        session: Task and seed.
        views: All of them.
        pushes: The ones between them.
        positive: As :func:`s2r_host.run.belief.estimate_part` takes it.

    Raises:
        AbstainError, SceneError: No pair tells it; the text is about the first pair tried.
    """
    problem: AbstainError | SceneError | None = None
    for k in _earlier(pushes, session.settings.task):
        pushed = _moving(pushes[k:])
        try:
            return views[k], estimate_part(
                views[k], views[-1], session.settings.task, positive, pushed, session.settings.seed
            )
        except (AbstainError, SceneError) as error:
            problem = problem or error
    assert problem is not None
    raise problem


def _earlier(pushes: Sequence[DonePush], task: Task) -> list[int]:
    """Which views to compare the newest with, the best first: each is the one before the push of its number.

    Since the first view the part has moved furthest. Of several drawers, though, an earlier push elsewhere may have
    moved another one, as far as the newest push moved this one: the two would be taken for one part.
    """
    newest_first = list(range(len(pushes) - 1, -1, -1))
    p_newest = pushes[-1].planned.motion.proposal.p_contact
    if task is DRAWER and any(
        push.moved and np.linalg.norm(push.planned.motion.proposal.p_contact - p_newest) > ELSEWHERE_M
        for push in pushes[:-1]
    ):
        return newest_first
    return [0, *newest_first[:-1]]


def _moving(pushes: Sequence[DonePush]) -> list[Push]:
    """What moved the part, as far as all of that is known: a push that was held out may have moved it, too."""
    if len(pushes) == 1 or all(push.sure for push in pushes):
        moving = [push for push in pushes if push.moved or len(pushes) == 1]
    else:
        moving = [push for push in pushes if push.went_through]
        moving = moving if len(moving) == 1 else []
    return [push.planned.motion.push_at_part for push in moving]
