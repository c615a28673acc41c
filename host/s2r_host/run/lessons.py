"""What a push and a manipulation teach about the part: how much it resists, and where its surfaces are."""

from __future__ import annotations

from pathlib import Path

from s2r_host.errors import SceneError
from s2r_host.run.belief import Belief
from s2r_host.run.contact import corrected, touched_by_push
from s2r_host.run.feeling import Feeling, with_felt
from s2r_host.run.first_push import PUSH
from s2r_host.run.measure_view import state_in
from s2r_host.run.push_until_told import Told
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Executed, Session


def learn_from_push(session: Session, record: RunRecord, feeling: Feeling, told: Told) -> None:
    """The push that told the joint also tells how much it resists, and where the side is that was touched."""
    task, belief, push, s = session.settings.task, record.belief, record.push, record.s_found
    assert belief is not None
    assert push is not None
    assert s is not None
    if not push.went_through:
        return
    try:
        s_before = state_in(belief, told.previous, told.before)
    except SceneError as error:
        session.journal.warn(f"the last push teaches nothing about the part's surface: {error}")
        return
    folder, positive = session.settings.out / "model-1", s > s_before
    belief = belief_with_felt(session, feeling, belief, push.executed[PUSH], s_before, s, folder)
    if not belief.template.slides and "touch" not in session.settings.without:
        touched = touched_by_push(
            belief, session.arm, push.planned.motion.push[-1], s, positive, task.far_off
        )
        if touched is not None:
            geom, offset = touched
            belief = corrected(belief, geom, offset, positive, folder)
            session.journal.say(
                f"the push touched {geom} {task.unit.show(-offset)} from where the model has it"
            )
    record.belief = belief


def belief_with_felt(
    session: Session,
    feeling: Feeling,
    belief: Belief,
    pushed: Executed,
    s_from: float,
    s_to: float,
    folder: Path,
) -> Belief:
    """The belief with what a motion made the arm feel of the part."""
    felt = feeling.feel(belief, session.executed, pushed, s_from, s_to)
    if not felt or "torque" in session.settings.without:
        return belief
    belief = with_felt(belief, feeling.touched, folder)
    if belief.felt is not None:
        effort, damping = ("N", "N·s/m") if belief.template.slides else ("N·m", "N·m·s/rad")
        session.journal.say(
            f"felt: friction {belief.felt.friction:.2f} {effort}, damping {belief.felt.damping:.2f} {damping}, "
            f"{belief.felt.mass_share:.2f} of the mass guessed"
        )
    return belief
