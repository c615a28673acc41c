"""A manipulation before it begins: planned through contact, timed, its way out proven."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from s2r_host.errors import TargetError
from s2r_host.motion.escape import Escape, plan_escape
from s2r_host.motion.nearest import nearest_to_tip
from s2r_host.motion.object_shapes import object_obstacles
from s2r_host.motion.obstacles import cloud_obstacle, table_obstacle
from s2r_host.planning import PlanRequest, PlanResult, PlanSettings, plan_manipulation
from s2r_host.planning.belief import Belief as ObjectBelief
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.planner import scene_of
from s2r_host.planning.reach import stops_on_the_way
from s2r_host.run.belief import Belief
from s2r_host.run.doubts import TOUCHED_SHARE, deep_about, doubt_about, room_about
from s2r_host.run.observe import Observation
from s2r_host.run.session import Motion, Session
from s2r_host.run.travel import FREE, LEAVING, timed
from s2r_host.run.tries import FailedTry, Try, grouped
from s2r_host.trajectory import Delivery, TimeLawSettings, deliver
from s2r_host.trajectory.perturb import PERTURBATIONS
from s2r_protocol.exits import RefusedError

logger = logging.getLogger(__name__)

# Share of the usual doubt about the object, one per try. In the end a plan that only just holds is better than none:
# where the part then is will be seen, and there is nothing yet to spoil.
DOUBTS = (1.0, 1.0, 1.0, 0.5, 0.5, 0.25, 0.25, 0.0, 0.0, 0.0)
# A correction of a part that is nearly where it should be is worth less than what a daring one can spoil.
CORRECTION_DOUBTS = (1.0, 1.0, 0.5)
# Tries with the usual, quick plans, and control steps to turn a part in of those after them: quick ones may throw a
# part whose way is short, and do not end on target then once they are timed.
QUICK_TRIES, TURN_STEPS = 2, 24
STOP_DOUBTS, MOST_STOPS = (0.5, 0.0), 3  # of a plan that ends on the way
ROUGHLY = 0.15  # share of the way that a plan may miss the target by when none meets it
# Share of the way to go within which a fragile plan has to leave every object that is believable: so near that it is
# surely worth it, or at least no farther than the part is now.
SURELY_NEARER, NO_FARTHER = 0.5, 1.0
OWN_REACH_M = 0.025  # observed points this near a piece of the model belong to it


@dataclass(frozen=True, eq=False)
class PlannedManipulation:
    """A manipulation that may be carried out.

    Attributes:
        number: Counts from 1.
        request, result, delivery: The task, the plan, the timed and replayed trajectory.
        escape: The way out of contact and home.
        motions: All of it, in order.
        pushed_geom: What the fingertip presses on at the end.
        yields: How much less far the model's arm, whose servos give way under the contact, moved the part than one that
            gets to where it is sent [m or rad].
        corrected: Other motions followed the first one than was planned.
        stopped: A protection stopped the arm on its way: it did not get to where the plan ends.
        pace: Share of the usual speed at which the part was to be moved.
    """

    number: int
    request: PlanRequest
    result: PlanResult
    delivery: Delivery
    escape: Escape
    motions: tuple[Motion, ...]
    pushed_geom: str
    yields: float = 0.0
    corrected: bool = False
    stopped: bool = False
    pace: float = 1.0

    @property
    def foreseen(self) -> float:
        """Joint value at the end, as the model has it for an arm that gets to where it is sent [m or rad]."""
        return self.delivery.replay.final + self.yields


def prepare_manipulation(
    session: Session,
    belief: Belief,
    number: int,
    s_initial: float,
    view: Observation,
    show: Callable[[float], str],
) -> PlannedManipulation:
    """Plan, time law, replay, way out; on failure again with other chance, then with less doubt about the object.

    Where no place behind the part carries it all the way, a plan to a state on the way is better than none: the next
    manipulation goes on from there, from another place. So is one that ends beside the target, in the end; and one
    that not every believable object survives, as long as it leaves none of them farther from the target than the part
    is now: where it then is will be seen.

    Args:
        session: Links and the target.
        belief: In the object.
        number: Of the manipulation, from 1.
        s_initial: Where the part is [m or rad].
        view: The newest look.
        show: Tells people a joint value.

    Raises:
        TargetError: No try succeeded; the text has the reasons.
        PeerUnreachableError: The executor fell silent.
    """
    task = session.settings.task
    to_go = abs(session.target - s_initial)
    on_target = _on_target(session.target, careful=number > 1 and to_go <= task.tolerance)
    failed: list[FailedTry] = []
    fragile: list[PlannedManipulation] = []

    def first_plan(tries: Iterable[Try]) -> PlannedManipulation | None:
        for one in tries:
            try:
                planned = _prepare_once(session, belief, number, s_initial, view, one)
            except RefusedError as error:
                reason = str(error)
            else:
                if planned.delivery.fragile is None:
                    return planned
                reason = planned.delivery.fragile
                fragile.append(planned)
            logger.info("try %d to plan manipulation %d: %s", one.number + 1, number, reason)
            failed.append(FailedTry(number, one, reason))
            session.journal.failed_tries.append(failed[-1])
        return None

    def least_fragile(share: float) -> PlannedManipulation | None:
        found = min(fragile, key=lambda one: one.delivery.strays, default=None)
        return found if found is not None and found.delivery.strays < share * to_go else None

    planned = first_plan(on_target)
    if planned is not None:
        return planned
    why = grouped([one.reason for one in failed])
    planned = least_fragile(SURELY_NEARER)
    if planned is None and to_go > task.far_off:  # else a correction is worth less than what it may spoil
        planned = first_plan(_second_best(session, belief, s_initial))
    planned = planned or least_fragile(NO_FARTHER)
    if planned is None:
        raise TargetError(
            f"no plan takes the {task.part} from {show(s_initial)} to {show(session.target)} "
            f"({len(on_target)} tries: {why}); try another target or placement"
        )
    if planned.delivery.fragile is None:
        told = f"all the way ({why}); first to {show(planned.foreseen)}"
    else:
        strays = task.unit.show(planned.delivery.strays)[1:]
        told = f"there whatever the object is like ({why}); one that ends at most {strays} from it is taken"
    session.journal.warn(f"no plan takes the {task.part} {told}")
    return planned


def _on_target(s_target: float, *, careful: bool) -> list[Try]:
    """What is tried for a plan that ends on target, in order."""
    return [
        Try(k, s_target, doubt, turn_steps=None if k < QUICK_TRIES else TURN_STEPS)
        for k, doubt in enumerate(CORRECTION_DOUBTS if careful else DOUBTS)
    ]


def _second_best(session: Session, belief: Belief, s_initial: float) -> list[Try]:
    """What to try when no plan ends on target: states on the way to it, then beside it."""
    stops = _stops(session, belief, s_initial)
    miss = ROUGHLY * abs(session.target - s_initial)
    on_the_way = [(stop, doubt, None) for doubt, stop in product(STOP_DOUBTS, stops)]
    beside = [(session.target, doubt, miss) for doubt in STOP_DOUBTS]
    return [Try(len(DOUBTS) + k, *what, TURN_STEPS) for k, what in enumerate([*on_the_way, *beside])]


def _stops(session: Session, belief: Belief, s_initial: float) -> list[float]:
    """States on the way to the target that one place could carry the part to, the first ones worth trying.

    None for a slide, which one place carries as far as it goes, or towards a target that is out of the part's range.
    """
    low, high = belief.model.range
    if belief.template.slides or not low <= session.target <= high:
        return []
    request = _request(session, belief, 0, s_initial, Try(0, session.target, STOP_DOUBTS[0]))
    scene = scene_of(request)
    world = FineWorld(scene, np.asarray(request.q_initial), s_initial)
    try:
        found = stops_on_the_way(scene, world, session.target, request.settings, slipped=True)
    except RefusedError as error:
        logger.info("states on the way to the target: %s", error)
        return []
    least = session.settings.task.far_off
    return [stop for stop in found if abs(stop - s_initial) > least][:MOST_STOPS]


def _prepare_once(
    session: Session, belief: Belief, number: int, s_initial: float, view: Observation, one: Try
) -> PlannedManipulation:
    settings = session.settings
    request = _request(session, belief, number, s_initial, one)
    result = plan_manipulation(request)
    if not result.success:
        raise TargetError(result.reason)
    pushed_at = session.arm.tool_pose(result.q_meas[-1])[:3, 3]
    doubts = tuple(_doubt(change, one.doubt, belief, request, pushed_at) for change in PERTURBATIONS)
    yields = _yields(session, belief, result)
    sent = replace(request, s_target=request.s_target - yields)
    touching = session.pace * TimeLawSettings.contact_speed_m_s
    pace = TimeLawSettings(speed=settings.plan_speed, contact_speed_m_s=touching)
    delivery = deliver(sent, result, pace, doubts, accept_fragile=True)
    played = delivery.replay
    touched = int(np.argmax(np.abs(played.s - s_initial) > settings.task.moving))
    end = ManipulationEnd(delivery.trajectory.q[-1], played.final, played.q_meas[:touched])
    escape, home = way_home(session, belief, request, number, view, end)
    motions = (Motion(delivery.trajectory, f"manipulation {number}"), *home)
    geom = _pushed_geom(session, request, delivery)
    return PlannedManipulation(
        number, request, result, delivery, escape, motions, geom, yields, pace=session.pace
    )


def _request(session: Session, belief: Belief, number: int, s_initial: float, one: Try) -> PlanRequest:
    """The task for the planner, with a share of the usual doubt about the object."""
    growing = one.s_target > s_initial
    settings = PlanSettings(
        ensemble=session.settings.ensemble,
        doubt=doubt_about(belief, growing=growing).scaled(one.doubt),
        room_m=room_about(belief, growing=growing, share=one.doubt),
        deep=deep_about(belief, one.doubt),
        turn_steps=one.turn_steps,
        missed=belief.missed_when(growing),
        proven=belief.proven_when(growing),
    )
    if one.tolerance is not None:
        settings = replace(settings, tolerance_m=one.tolerance, tolerance_rad=one.tolerance)
    return PlanRequest(
        arm=session.arm.arm,
        object_mjcf=belief.path(growing),
        s_initial=s_initial,
        s_target=one.s_target,
        q_initial=session.status().q_ref,
        seed=session.settings.seed + 1000 * number + one.number,
        settings=settings,
    )


def _yields(session: Session, belief: Belief, result: PlanResult) -> float:
    """How much further the part goes with an arm that gets to where it is sent than in the model [m or rad].

    The model's servos are springs: pushing with 10 N they stay a milliradian behind, and the fingertip one or two
    millimetres. A drive with an integral part does not.
    """
    sent, reached = (session.arm.tool_pose(q[-1])[:3, 3] for q in (result.q_cmd, result.q_meas))
    velocity = belief.template.velocity(reached[None])[0]
    return float((sent - reached) @ velocity / (velocity @ velocity))


@dataclass(frozen=True, eq=False)
class ManipulationEnd:
    """Where a manipulation leaves the arm: posture (dof,) [rad], the joint's value, the way in (n, dof) [rad]."""

    q: np.ndarray
    s: float
    way_in: np.ndarray


def way_home(
    session: Session,
    belief: Belief,
    request: PlanRequest,
    number: int,
    view: Observation,
    end: ManipulationEnd,
) -> tuple[Escape, tuple[Motion, ...]]:
    """Out of contact and home from the end of a manipulation.

    Raises:
        NoMotionError: Every direction is blocked.
    """
    settings = session.settings
    near = [*object_obstacles(Path(request.object_mjcf), end.s), table_obstacle()]
    far = [*near, cloud_obstacle(_unmodelled(belief, view, request.s_initial), name="surroundings")]
    sign = float(np.sign(request.s_target - request.s_initial))
    escape = plan_escape(
        session.arm,
        near,
        far,
        end.q,
        session.arm.arm.q_home,
        sign * belief.direction_at(session.arm.tool_pose(end.q)[:3, 3]),
        session.rng,
        way_in=end.way_in,
        carried=belief.carried(request.s_initial, end.s),
    )
    return escape, (
        timed(session, escape.out, f"manipulation {number}: out of contact", settings.push_speed, LEAVING),
        timed(session, escape.home, f"manipulation {number}: home", settings.travel_speed, FREE),
    )


def _doubt(
    one: ObjectBelief, share: float, belief: Belief, request: PlanRequest, pushed_at: np.ndarray
) -> ObjectBelief:
    """A perturbation with a share of its displacement and of its (logarithmic) change of resistance.

    Of a hinge's side that has been touched the place is known along its motion, which at ``pushed_at`` (3,) is what
    counts, but for fractions of a millimetre. Across the motion it is as little known as before: a fingertip that
    just reaches the side may miss it.
    A slide may end higher or lower than believed, because its axis is known to some angle only: what a fingertip
    hooks over an edge must survive that. A hinge holds its part against gravity wherever it was found, so it cannot
    have much less friction than believed.
    """
    (x, y, z), resistance = one.shift_m, one.damping
    if belief.template.slides:
        angle_rad = belief.estimate.intervals90.axis_angle_rad
        z += 0.5 * np.sign(z) * angle_rad * abs(request.s_target - request.s_initial)
    else:
        resistance = max(resistance, 1.0)
        if belief.touched(request.s_target > request.s_initial):
            way = belief.direction_at(pushed_at)
            x, y, z = np.array([x, y, z]) - (1.0 - TOUCHED_SHARE) * float(way @ (x, y, z)) * way
    resistance = resistance**share
    return replace(
        one, shift_m=(share * x, share * y, share * z), damping=resistance, joint_friction=resistance
    )


def _pushed_geom(session: Session, request: PlanRequest, delivery: Delivery) -> str:
    """What the fingertip is nearest to when it moves the part for the last time in the replay."""
    played = delivery.replay
    moving = np.flatnonzero(np.abs(np.diff(played.s)) > session.settings.task.moving)
    row = int(moving[-1]) if len(moving) else len(played.s) - 1
    shapes = object_obstacles(Path(request.object_mjcf), float(played.s[row]))
    part = [shape for shape in shapes if shape.name.startswith("part_")]
    return nearest_to_tip(session.arm, played.q_meas[row], part)[0]


def _unmodelled(belief: Belief, view: Observation, s: float) -> np.ndarray:
    """Observed points that belong to no piece of the model at joint value s: other things on the table, (n, 3)."""
    p = view.scene.p_base
    near = np.zeros(len(p), bool)
    moved = belief.template.pose(s)
    for piece in belief.model.pieces:
        X = moved @ piece.X_base_piece if piece.body == "part" else piece.X_base_piece
        local = (p - X[:3, 3]) @ X[:3, :3]
        low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        near |= np.all((local > low - OWN_REACH_M) & (local < high + OWN_REACH_M), axis=1)
    return p[~near]
