"""Whether what the gap tool named with moderate evidence is believed: it has to foretell the motions made so far."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from s2r_host.run.lost_motion import foreseen, tells
from s2r_host.run.physics import JointLaw, newest_law
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Session

SURE = 0.95  # probability from which on a name needs nothing besides; the gap tool gives 0.98 at most
BETTER = 0.9  # of what motions ended beside without it: that much has to be gone


def weigh_newest(session: Session, record: RunRecord) -> None:
    """Take the newest lesson's law back where an effect in it is not sure and no motion is foretold better with it.

    What the lesson named stays named. Plans go on with the law before, if there is one.

    Args:
        session: Of the run.
        record: Its newest lesson is replaced.
    """
    lesson, earlier = record.lessons[-1], newest_law(record.lessons[:-1])
    unsure = [effect["name"] for effect in lesson.effects if effect["probability"] < SURE]
    carried = [name for name in unsure if name in lesson.carried]
    if lesson.law is None or not carried:
        return
    folder = session.settings.out / f"weighed-{lesson.after}"
    without, with_it = (beside(session, record, law, folder / name) for name, law in
                        (("without", earlier), ("with", lesson.law)))  # fmt: skip
    if with_it < BETTER * without:
        return
    show = session.settings.task.unit.show
    note = (
        f"{', '.join(carried)} not sure: the motions so far ended {show(without)} beside where they are foreseen "
        f"without and {show(with_it)} with it; plans go on without"
    )
    record.lessons[-1] = replace(
        lesson,
        law=None,
        carried=(),
        not_carried=(*lesson.not_carried, *lesson.carried),
        notes=(*lesson.notes, note),
    )
    session.journal.say(note)


def beside(session: Session, record: RunRecord, law: JointLaw | None, folder: Path) -> float:
    """How far beside where they are foreseen with a law the motions so far left the part, mean [m or rad].

    One that would have been left nowhere near counts as far off; without any motion that tells, zero.
    """
    task, belief = session.settings.task, record.belief
    assert belief is not None
    told = [one for one in record.attempts if tells(one, task)]
    ends = [foreseen(one, session, belief, law, folder) for one in told]
    missed = [
        task.far_off if s is None else min(abs(one.measured.s - s), task.far_off)
        for one, s in zip(told, ends, strict=True)
    ]
    return float(np.mean(missed)) if missed else 0.0
