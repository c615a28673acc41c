"""The joint told anew by a planned manipulation that moved the part further than the pushes did.

A first push turns a lever by ten degrees, of which a camera tells its hinge to a centimetre; a manipulation turns it
by thirty. Where what the newest view shows contradicts the joint believed so far, the object is modelled anew, and what
was done so far is told in the new joint's values. A joint that the new view confirms is kept, with all that touching
its part has taught; so is one that was told by an outline in colour, which needs no larger motion.
"""

from __future__ import annotations

from dataclasses import replace

from s2r_host.errors import SceneError
from s2r_host.model.errors import ModelError
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.intervals import Z90
from s2r_host.perception.motion import line_distance
from s2r_host.run.belief import Belief, build_belief, estimate_part
from s2r_host.run.measure import Measurement
from s2r_host.run.measure_view import state_if_seen, state_in
from s2r_host.run.observe import Observation
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Session

FURTHER = 1.25  # times the motion that told the joint so far
OFF_M = 0.004  # between hinges, from which on they contradict each other


def tell_again(session: Session, record: RunRecord, view: Observation) -> bool:
    """Whether the newest view tells another joint. If it does, belief, goals and target are of that joint.

    The target stays as far as before from the state that it is counted from. What the arm felt and touched so far went
    into the belief given up; it is not carried over. So are the laws that the gap tool found: they are of the other
    joint, until the next lesson.

    Args:
        session: Links and the target.
        record: So far, the newest manipulation measured in the joint believed so far.
        view: The look after it.
    """
    belief, settings, journal = record.belief, session.settings, session.journal
    assert belief is not None
    s_now, number = record.goals[-1].last.measured.s, len(record.attempts)
    assert record.s_found is not None
    known = {record.zero_view: 0.0, record.found_view: record.s_found}
    name = max(known, key=lambda name: abs(s_now - known[name]))
    moved = s_now - known[name]
    further = abs(moved) > FURTHER * abs(belief.estimate.delta)
    outlined = belief.estimate.knob is not None or belief.estimate.lever is not None
    if belief.template.slides or outlined or not further:
        return False
    with journal.stage(f"tell joint again {number}") as stage:
        try:
            zero = record.view(name)
            estimate = estimate_part(zero, view, settings.task, belief.axis, (), settings.seed)
            if not _contradicts(belief, estimate, moved, settings.task.good_enough):
                stage.note = "as believed"
                return False
            new = build_belief(estimate, settings.out / f"model-told-again-{number}", settings.seed)
            _count_anew(session, record, new, zero, view)
        except (AbstainError, SceneError, ModelError) as error:
            stage.note = f"left as believed: {error}"
            return False
        show = settings.task.unit.show
        stage.note = f"another hinge: moved {show(estimate.delta)} since view {name}, not {show(moved)}"
    return True


def tell_lost(
    session: Session, record: RunRecord, before: Observation, view: Observation
) -> Measurement | None:
    """The part's state in the newest view by another joint, where the one believed does not let it be where it is.

    A joint told wrongly by a small motion loses its part in a large one. That large motion tells it better. Belief,
    goals and target are of the new joint then, as in :func:`tell_again`.

    Args:
        session: Links and the target.
        record: So far, without the newest manipulation.
        before: The look before that.
        view: The look after it.

    Returns:
        As the new joint is told; None where none is, or the part is of a kind that is not told anew.
    """
    belief, settings, journal = record.belief, session.settings, session.journal
    assert belief is not None
    if belief.template.slides or belief.estimate.knob is not None:
        return None
    number = len(record.attempts) + 1
    journal.warn("the part is not where the joint believed lets it be; looking for another joint")
    for name in dict.fromkeys((before.name, record.found_view, record.zero_view)):
        with journal.stage(f"tell joint anew {number}, from view {name}") as stage:
            try:
                zero = record.view(name)
                estimate = estimate_part(zero, view, settings.task, belief.axis, (), settings.seed)
                new = build_belief(estimate, settings.out / f"model-told-anew-{number}-{name}", settings.seed)
                _count_anew(session, record, new, zero, view)
            except (AbstainError, SceneError, ModelError) as error:
                stage.note = f"not told: {error}"
                continue
            stage.note = f"another hinge: moved {settings.task.unit.show(estimate.delta)} since view {name}"
        low, high = estimate.intervals90.delta
        sigma = 0.5 * (high - low) / Z90
        return Measurement(float(estimate.delta), sigma, estimate.residual_m, estimate.explained)
    return None


def _contradicts(belief: Belief, estimate: JointEstimate, moved: float, good_enough: float) -> bool:
    """Whether a joint is surer than the believed one, and differs from it by more than corrections make good."""
    old = belief.estimate
    if estimate.intervals90.axis_offset_m >= old.intervals90.axis_offset_m:
        return False
    apart_m = line_distance(estimate.axis_origin_m, estimate.axis_direction, old.axis_origin_m[None])[0]
    return bool(apart_m > OFF_M or abs(estimate.delta - moved) > good_enough)


def _count_anew(
    session: Session, record: RunRecord, belief: Belief, zero: Observation, told: Observation
) -> None:
    """All that was aimed at and measured so far, in values of another joint, told by two views, from the first of them.

    Raises:
        SceneError: The part is not seen in one of the views.
    """
    first = record.views[0]
    origin = state_in(belief, record.view(record.origin_view), zero)
    s_first = origin if record.origin_view == first.name else state_if_seen(belief, first, zero)
    s = s_found = state_in(belief, record.view(record.found_view), zero)
    goals = []
    for goal in record.goals:
        target, attempts, s_before = origin + goal.target - record.origin, [], s
        for done in goal.attempts:
            measured = replace(done.measured, s=state_in(belief, done.view, zero))
            shift = done.shift + s - done.s_initial
            attempts.append(replace(done, s_initial=s, s_target=target, measured=measured, shift=shift))
            s = measured.s
        goals.append(replace(goal, target=target, attempts=attempts, s_before=s_before))
    record.belief, record.origin, record.s_found, record.goals = belief, origin, s_found, goals
    record.s_first = s_first
    record.lessons = [replace(lesson, law=None) for lesson in record.lessons]
    record.zero_view, record.told_view = zero.name, told.name
    session.target = goals[-1].target
