"""A manipulation before it begins: planned through contact, timed, its way out proven."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from s2r_host.errors import TargetError
from s2r_host.motion.escape import Escape, plan_escape
from s2r_host.motion.object_shapes import object_obstacles
from s2r_host.motion.obstacles import cloud_obstacle, table_obstacle
from s2r_host.planning import PlanRequest, PlanResult, PlanSettings, plan_manipulation
from s2r_host.planning.belief import Belief as ObjectBelief
from s2r_host.planning.planner import scene_of
from s2r_host.run.belief import Belief
from s2r_host.run.doubts import TOUCHED_SHARE, deep_about, doubt_about, room_about
from s2r_host.run.end import End, end_of
from s2r_host.run.observe import Observation
from s2r_host.run.session import Motion, Session
from s2r_host.run.travel import FREE, LEAVING, timed
from s2r_host.run.tries import Try
from s2r_host.trajectory import Delivery, TimeLawSettings, deliver
from s2r_host.trajectory.deliver import MotionHitsError, apart
from s2r_host.trajectory.perturb import PERTURBATIONS

BESIDE = 0.1  # of what is good enough: motions that leave the part further beside are timed once more
# How far the servos of a plan's end are believed to give way at first: at the fingertip, and as a share of the way.
YIELDS_M, YIELDS_SHARE = 0.002, 0.25
OWN_REACH_M = 0.025  # observed points this near a piece of the model belong to it


@dataclass(frozen=True, eq=False)
class PlannedManipulation:
    """A manipulation that may be carried out.

    Attributes:
        number: Counts from 1.
        request, result, delivery: The task, the plan, the timed and replayed trajectory.
        escape: The way out of contact and home.
        motions: All of it, in order.
        end: How the fingertip leaves the part.
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
    end: End
    corrected: bool = False
    stopped: bool = False
    pace: float = 1.0

    @property
    def foreseen(self) -> float:
        """Joint value at the end, as the model has it for an arm that gets to where it is sent [m or rad]."""
        return self.delivery.replay.final + self.end.yields


def planned_once(
    session: Session, belief: Belief, number: int, s_initial: float, view: Observation, one: Try
) -> PlannedManipulation:
    """Plan, time law, replay, way out. The plan may be fragile: ``delivery.fragile`` says so.

    Args:
        session: Links and settings.
        belief: In the object.
        number: Of the manipulation, from 1.
        s_initial: Where the part is [m or rad].
        view: The newest look.
        one: What is tried.

    Raises:
        MotionHitsError: What is planned touches something else than the part.
        RefusedError: There is no plan, or none that can be delivered, or no way out.
        PeerUnreachableError: The executor fell silent.
    """
    settings = session.settings
    request = request_for(session, belief, number, s_initial, one)
    scene = scene_of(request)
    result = plan_manipulation(request, scene)
    if not result.success:
        raise (TargetError if result.contact is None else MotionHitsError)(result.reason)
    pushed_at = session.arm.tool_pose(result.q_meas[-1])[:3, 3]
    doubts = tuple(_doubt(change, one.doubt, belief, request, pushed_at) for change in PERTURBATIONS)
    yields = servos_yield(session, belief, request, result)
    touching = session.pace * TimeLawSettings.contact_speed_m_s
    pace = TimeLawSettings(speed=settings.plan_speed, contact_speed_m_s=touching)

    def delivered(yields: float) -> tuple[Delivery, End]:
        sent = replace(request, s_target=request.s_target - yields)
        delivery = deliver(sent, result, pace, doubts, scene=scene, accept_fragile=True)
        return delivery, end_of(session.arm, belief, request, delivery, yields, settings.task)

    delivery, end = delivered(yields)
    beside = abs(delivery.replay.final + end.yields - request.s_target)
    if end.touching and beside > BESIDE * settings.task.good_enough:
        delivery, end = delivered(end.yields)
    played = delivery.replay
    touched = int(np.argmax(np.abs(played.s - s_initial) > settings.task.moving))
    left = ManipulationEnd(delivery.trajectory.q[-1], played.final, played.q_meas[:touched])
    escape, home = way_home(session, belief, request, number, view, left)
    motions = (Motion(delivery.trajectory, f"manipulation {number}"), *home)
    return PlannedManipulation(number, request, result, delivery, escape, motions, end, pace=session.pace)


def request_for(session: Session, belief: Belief, number: int, s_initial: float, one: Try) -> PlanRequest:
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
    request = PlanRequest(
        arm=session.arm.arm,
        object_mjcf=belief.path(growing),
        s_initial=s_initial,
        s_target=one.s_target,
        q_initial=session.status().q_ref,
        seed=session.settings.seed + 1000 * number + one.number,
        settings=settings,
    )
    return apart(request) if one.apart else request


def servos_yield(session: Session, belief: Belief, request: PlanRequest, result: PlanResult) -> float:
    """How much further the part goes with an arm that gets to where it is sent than in the model [m or rad], roughly.

    The model's servos are springs: pushing with 10 N they stay a milliradian behind, and the fingertip one or two
    millimetres. A drive with an integral part does not. This is what a timed motion begins with; its own end tells it
    better (:func:`end_of`). A plan may end pressing harder, or pulled along by the part: what its servos lack then is
    no word about the timed motion, and a target so far off would be refused.
    """
    sent, reached = (session.arm.tool_pose(q[-1])[:3, 3] for q in (result.q_cmd, result.q_meas))
    velocity = belief.template.velocity(reached[None])[0]
    way = request.s_target - request.s_initial
    behind = float((sent - reached) @ velocity / (velocity @ velocity)) * np.sign(way)
    most = min(YIELDS_M / np.linalg.norm(velocity), YIELDS_SHARE * abs(way))
    return float(np.clip(behind, 0.0, most) * np.sign(way))


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
        timed(
            session,
            escape.out,
            f"manipulation {number}: out of contact",
            settings.push_speed,
            LEAVING,
            escape.clearance_m,
        ),
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
