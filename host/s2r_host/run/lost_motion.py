"""Lost motion: how far beside the foreseen place motions leave the part, learnt after every target.

A camera sees a lever or a handle from one side, drives give way, a part coasts on: motions of one direction end beside
where they were foreseen to, and nearly as far each time. No effort shows that, the look after each motion does. All
motions so far are played again in the object as it is believed now, so that what was learnt since about its joint
counts for them as well, or the part is put to where the fingertip stopped, where it pushed to the end; the surface that
was pushed is moved to where what is left says it is (:mod:`.side`).
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.perception.estimate import JointEstimate
from s2r_host.planning.doubt import Z90
from s2r_host.run.belief import Belief
from s2r_host.run.contact import corrected, side_moved, touch_at
from s2r_host.run.manipulate import DoneManipulation
from s2r_host.run.physics import JointLaw, braked, newest_law
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Session
from s2r_host.run.side import Touch, hinge_columns, hinge_doubts, none_slipped, transform, where
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
        found: Surface pushed and direction -> how much less far than foreseen the part went in the median, by which the
            surface was moved [m or rad].
        moved: Surface (of a slide; of a hinge the part) and direction -> how the pushed side was moved against its
            motions: a slide's face [m], (1,); a hinge's side, turn [rad] and shift [m], (6,).
    """

    after: int
    found: dict[str, float]
    moved: dict[str, np.ndarray] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {
            "after_manipulations": self.after,
            "surfaces": self.found,
            "moved": {what: moved.tolist() for what, moved in self.moved.items()},
        }


def learn_lost_motion(session: Session, record: RunRecord) -> None:
    """Move the surfaces that were pushed so far to where the motions that pushed them say they are.

    Args:
        session: Of the run.
        record: Its belief gets what is learnt.
    """
    settings, task, done = session.settings, session.settings.task, len(record.attempts)
    ways = {} if record.belief is None or "touch" in settings.without else _ways(record)
    if record.belief is None or not ways:
        return
    found: dict[str, float] = {}
    moved: dict[str, np.ndarray] = {}
    with session.journal.stage(f"lost motion after {done}") as stage:
        for k, ((positive, surface), like) in enumerate(ways.items(), start=1):
            way, folder = (
                f"{surface or task.part}, {WAY[positive]}",
                settings.out / f"surfaces-{done}" / str(k),
            )
            touches = _touches(like, session, record.belief, record, folder)
            if not touches:
                continue
            so_far = record.belief.moved.get(way, np.zeros(len(touches[0].columns)))
            step = _where(touches, so_far, record.belief, task) - so_far
            offset = _median(touches, step)
            if abs(offset) < LEAST * task.good_enough:
                continue
            geom, _ = Counter(one.planned.end.geom for one in like).most_common(1)[0]
            belief = _with_side(record.belief, geom, step, offset, folder, positive=positive)
            again = _touches(like, session, belief, record, folder)
            if not again or abs(_median(again) - (_median(touches) - offset)) > FOLLOWS * abs(offset):
                continue
            record.belief, moved[way] = replace(belief, moved={**belief.moved, way: so_far + step}), step
            found[f"{geom}, {WAY[positive]}"] = -offset if positive else offset
        stage.note = (
            "; ".join(f"{task.unit.show(lost)} at {what}" for what, lost in found.items()) or "as known"
        )
    if found:
        record.lost_motion.append(LostMotion(done, found, moved))


def tells(done: DoneManipulation, task: Task) -> bool:
    """Whether where a motion left the part says where its surface is.

    Not one that was corrected on its way or stopped, nor one that ended far off or astray: there the part stayed, the
    fingertip slipped or the part went on by itself; nor the short ones that correct another. Hinges coast, but not
    where they are moved slowly, so that a slow motion tells nothing of the usual ones unless the fingertip pushed to
    the end; slides never do.
    """
    planned = done.planned
    if planned.corrected or planned.stopped or abs(done.s_target - done.s_initial) < task.far_off:
        return False
    if planned.pace < 1.0 and task.joint_type == "revolute" and not planned.end.touching:
        return False
    return not done.astray and abs(done.measured.s - done.foreseen) < task.far_off


def _ways(record: RunRecord) -> dict[tuple[bool, str], list[DoneManipulation]]:
    """The motions that tell something of the side they pushed, by direction; of a slide by surface as well, each of
    which is learnt apart."""
    task, ways = record.settings.task, defaultdict(list)
    for one in record.attempts:
        if tells(one, task) and not one.planned.end.at_edge:
            surface = one.planned.end.geom if task.joint_type == "prismatic" else ""
            ways[_grew(one), surface].append(one)
    return ways


def _grew(done: DoneManipulation) -> bool:
    return done.s_target > done.s_initial


def _touches(
    like: Sequence[DoneManipulation], session: Session, belief: Belief, record: RunRecord, folder: Path
) -> list[Touch]:
    """How far beyond (negative: short of) where a belief foresees them motions of one kind ended.

    Without those that ended far off: one motion that went another way must not shift the rest.
    """
    touches = (
        _touch(one, one.measured.s - s, belief, record.settings.task.beside)
        for one in like
        if (s := foreseen(one, session, belief, newest_law(record.lessons), folder)) is not None
    )
    return [touch for touch in touches if abs(touch.offset) < record.settings.task.far_off]


def _touch(done: DoneManipulation, offset: float, belief: Belief, beside: float) -> Touch:
    """One motion. A hinge told vaguely may make any offset in a look, but hardly more than motions usually end beside:
    what five looks in a row have alike deserves to be believed."""
    template, measured = belief.template, done.measured
    if template.slides:
        return Touch(offset, measured.sigma, 0.0, np.ones(1))
    # Since it was planned, joint value 0 may have become another place.
    p = belief.carry(done.planned.end.p_pushed, done.shift, 0.0)
    velocity = template.velocity(p[None])[0]
    joint = min(_of_the_joint(belief.estimate, measured.s, float(np.linalg.norm(velocity))), beside)
    return Touch(offset, measured.sigma, joint, hinge_columns(p, template.p.mean(axis=0), velocity))


def _of_the_joint(estimate: JointEstimate, s: float, radius_m: float) -> float:
    """How far beside a part may be seen because its hinge lies beside where it is believed, one standard deviation.

    Both views that told the hinge were laid on each other, so there it makes no error; turned on from the nearer one,
    the part is carried about a line that is somewhat off [rad].
    """
    turned = min(abs(s), abs(s - estimate.delta))
    return estimate.intervals90.axis_offset_m / Z90 * 2.0 * float(np.sin(0.5 * turned)) / radius_m


def _where(touches: Sequence[Touch], so_far: np.ndarray, belief: Belief, task: Task) -> np.ndarray:
    """Where the side is, against where it was modelled before any lesson."""
    whole = [replace(touch, offset=touch.offset + float(touch.columns @ so_far)) for touch in touches]
    if belief.template.slides:
        return where(whole, task.beside, np.array([[task.beside**2]]))
    radius_m = float(np.median([1.0 / np.linalg.norm(touch.columns[3:]) for touch in touches]))
    lever = belief.estimate.lever
    prior = hinge_doubts(task.beside, radius_m, None if lever is None else lever.along)
    return where(none_slipped(whole, task.beside), task.beside, prior)


def _with_side(
    belief: Belief, geom: str, step: np.ndarray, offset: float, folder: Path, *, positive: bool
) -> Belief:
    if belief.template.slides:
        return corrected(belief, geom, float(step[0]), positive, folder)
    return side_moved(belief, transform(step, belief.template.p.mean(axis=0)), offset, positive, folder)


def _median(touches: Sequence[Touch], step: np.ndarray | None = None) -> float:
    """Of their offsets, or of what a step of the side does to them; 0 where there are none [m or rad]."""
    values = [touch.offset if step is None else float(touch.columns @ step) for touch in touches]
    return float(np.median(values)) if values else 0.0


def foreseen(
    done: DoneManipulation, session: Session, belief: Belief, law: JointLaw | None, folder: Path
) -> float | None:
    """Where the object as believed would have been left by a motion that was made [m or rad].

    Args:
        done: The motion.
        session: Of the run.
        belief: In the object.
        law: Its joint as the gap tool has it; None: as the object file has it.
        folder: For the files of objects that are braked by the law.

    Returns:
        None: it would have been left nowhere near where the fingertip stopped.
    """
    planned, positive = done.planned, _grew(done)
    if planned.end.touching:
        q_end, far_off = planned.delivery.trajectory.q[-1], session.settings.task.far_off
        touched = touch_at(belief.path(positive), session.arm, q_end, done.measured.s, positive, far_off)
        return None if touched is None else touched.s
    path = belief.path(positive)
    if law is not None:
        path = braked(
            belief,
            law,
            done.s_target,
            folder / f"again-{planned.number}.xml",
            positive=positive,
            rests_at=planned.request.s_initial + done.shift,
        )
    request = replace(
        planned.request,
        object_mjcf=path,
        s_initial=planned.request.s_initial + done.shift,
        s_target=planned.request.s_target + done.shift,
    )
    return replay(planned.delivery.trajectory, request).final + planned.end.yields
