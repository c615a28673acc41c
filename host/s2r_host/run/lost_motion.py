"""Lost motion: how far beside the foreseen place motions leave the part, learnt after every target.

A camera sees a lever or a handle from one side, drives give way, a part coasts on: motions of one direction end beside
where they were foreseen to, and nearly as far each time. No effort shows that, the look after each motion does. All
motions so far are played again in the object as it is believed now, so that what was learnt since about its joint
counts for them as well; the surface that was pushed is moved by the median of what is left.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.run.belief import Belief
from s2r_host.run.contact import corrected
from s2r_host.run.manipulate import DoneManipulation
from s2r_host.run.physics import braked, newest_law
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Session
from s2r_host.run.task import Task
from s2r_host.trajectory.verify import replay

WAY = {True: "growing", False: "falling"}
LEAST = 0.02  # of what is good enough: less is not worth a new object file
FOLLOWS = 0.5  # of the offset that may be left once the surface is moved: else it is not what decides where they end


@dataclass(frozen=True)
class LostMotion:
    """What the motions so far taught about where they leave the part.

    Attributes:
        after: Planned manipulations carried out by then.
        found: Surface pushed and direction -> how much less far than foreseen the part went, by which the surface was
            moved [m or rad].
    """

    after: int
    found: dict[str, float]

    def as_json(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {"after_manipulations": self.after, "surfaces": self.found}


def learn_lost_motion(session: Session, record: RunRecord) -> None:
    """Move the surfaces that were pushed so far to where the motions that pushed them say they are.

    Args:
        session: Of the run.
        record: Its belief gets what is learnt.
    """
    settings, task, done = session.settings, session.settings.task, len(record.attempts)
    ways = _ways(record)
    if record.belief is None or not ways or "touch" in settings.without:
        return
    found: dict[str, float] = {}
    with session.journal.stage(f"lost motion after {done}") as stage:
        for k, ((positive, _), like) in enumerate(ways.items(), start=1):
            folder = settings.out / f"surfaces-{done}" / str(k)
            geom, _ = Counter(one.planned.pushed_geom for one in like).most_common(1)[0]
            left, so_far = _offset(like, record.belief, record, folder), _learnt(record, geom, positive)
            offset = trust(like, task.beside) * (left + so_far) - so_far
            if abs(offset) < LEAST * task.good_enough:
                continue
            moved = corrected(record.belief, geom, offset, positive, folder)
            if abs(_offset(like, moved, record, folder) - (left - offset)) > FOLLOWS * abs(offset):
                continue
            record.belief = moved
            found[f"{geom}, {WAY[positive]}"] = -offset if positive else offset
        stage.note = (
            "; ".join(f"{task.unit.show(lost)} at {what}" for what, lost in found.items()) or "as known"
        )
    if found:
        record.lost_motion.append(LostMotion(done, found))


def tells(done: DoneManipulation, task: Task) -> bool:
    """Whether where a motion left the part says where its surface is.

    Not one that was corrected on its way or stopped, nor one that ended far off: there the fingertip slipped or the
    part went on by itself; nor the short ones that correct another. Hinges coast, but not where they are moved slowly,
    so that a slow motion tells nothing of the usual ones; slides never do.
    """
    planned = done.planned
    if planned.corrected or planned.stopped or abs(done.s_target - done.s_initial) < task.far_off:
        return False
    if planned.pace < 1.0 and task.joint_type == "revolute":
        return False
    return abs(done.measured.s - done.foreseen) < task.far_off


def trust(like: Sequence[DoneManipulation], beside: float) -> float:
    """Share of an offset that is believed, by how well the camera sees the part there.

    A lid seen edge-on is measured to 0.7°, which is more than motions usually leave it beside its target, and the error
    is alike each time: that does not average out. Least squares of an offset with that prior and that measurement.
    """
    sigma = float(np.median([one.measured.sigma for one in like]))
    return beside**2 / (beside**2 + sigma**2) if np.isfinite(sigma) else 0.0


def median_within(offsets: Sequence[float], far_off: float) -> float:
    """The median of those that are not far off; 0 where there are none.

    One motion among several that went another way (a notch, a place where friction is higher) must not shift the rest.
    """
    near = [offset for offset in offsets if abs(offset) < far_off]
    return float(np.median(near)) if near else 0.0


def _ways(record: RunRecord) -> dict[tuple[bool, str], list[DoneManipulation]]:
    """The motions that tell something, by direction; of a slide by surface as well: each of its surfaces is learnt
    apart, while a hinge's part turns as a whole."""
    task, ways = record.settings.task, defaultdict(list)
    for one in record.attempts:
        if tells(one, task):
            surface = one.planned.pushed_geom if task.joint_type == "prismatic" else ""
            ways[_grew(one), surface].append(one)
    return ways


def _learnt(record: RunRecord, geom: str, positive: bool) -> float:
    """The offset that lessons so far have taken out of motions of one kind [m or rad]."""
    found = [entry for lesson in record.lost_motion for entry in lesson.found.items()]
    if record.settings.task.joint_type == "prismatic":
        lost = sum(value for what, value in found if what == f"{geom}, {WAY[positive]}")
    else:  # its part was turned as a whole, whatever was pushed then
        lost = sum(value for what, value in found if what.endswith(WAY[positive]))
    return -lost if positive else lost


def _grew(done: DoneManipulation) -> bool:
    return done.s_target > done.s_initial


def _offset(like: Sequence[DoneManipulation], belief: Belief, record: RunRecord, folder: Path) -> float:
    """How far beyond (negative: short of) where a belief foresees them motions of one kind ended [m or rad]."""
    far_off = record.settings.task.far_off
    return median_within([one.measured.s - _foreseen(one, belief, record, folder) for one in like], far_off)


def _foreseen(done: DoneManipulation, belief: Belief, record: RunRecord, folder: Path) -> float:
    """Where the object as believed would have been left by a motion that was made [m or rad]."""
    planned, positive = done.planned, _grew(done)
    path, law = belief.path(positive), newest_law(record.lessons)
    if law is not None:
        path = braked(belief, law, done.s_target, folder / f"again-{planned.number}.xml", positive=positive)
    request = replace(
        planned.request,
        object_mjcf=path,
        s_initial=planned.request.s_initial + done.shift,
        s_target=planned.request.s_target + done.shift,
    )
    return replay(planned.delivery.trajectory, request).final + planned.yields
