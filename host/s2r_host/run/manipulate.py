"""One planned manipulation: plan through contact, time it, prove the way out, execute, measure."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from s2r_host.errors import TargetError
from s2r_host.motion.escape import Escape, plan_escape
from s2r_host.motion.nearest import nearest_to_tip
from s2r_host.motion.object_shapes import object_obstacles
from s2r_host.motion.obstacles import cloud_obstacle, table_obstacle
from s2r_host.planning import PlanRequest, PlanResult, plan_manipulation
from s2r_host.run.belief import Belief
from s2r_host.run.measure import Measurement, measure_state
from s2r_host.run.observe import Observation, observe
from s2r_host.run.session import Executed, Motion, Session
from s2r_host.run.travel import timed
from s2r_host.trajectory import Delivery, TimeLawSettings, deliver

PLAN_TRIES = 3
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
    """

    number: int
    request: PlanRequest
    result: PlanResult
    delivery: Delivery
    escape: Escape
    motions: tuple[Motion, ...]
    pushed_geom: str


@dataclass(frozen=True, eq=False)
class DoneManipulation:
    """A manipulation that was carried out and measured.

    Attributes:
        planned: What was to happen.
        executed: What was sent and recorded.
        view: The look afterwards.
        measured: Where the part is now.
        s_initial: Where it was just before, by the camera [m].
        s_target: Where it should be [m].
    """

    planned: PlannedManipulation
    executed: tuple[Executed, ...]
    view: Observation
    measured: Measurement
    s_initial: float
    s_target: float

    @property
    def delta_m(self) -> float:
        """δ = s_target − s_final [m]."""
        return self.s_target - self.measured.s_m

    @property
    def delta_r(self) -> float:
        """δ_r = δ / (s_target − s_initial)."""
        return self.delta_m / (self.s_target - self.s_initial)


def prepare_manipulation(
    session: Session, belief: Belief, number: int, s_initial: float, view: Observation
) -> PlannedManipulation:
    """Plan, time law, replay, way out.

    Raises:
        PlanRefusedError, OutOfReachError: The target is impossible with this object and placement.
        TargetError: No plan was found.
        NoMotionError: No way out of contact.
        TrajectoryError: The path cannot be timed.
    """
    request, result = _plan(session, belief, number, s_initial)
    delivery = deliver(request, result, TimeLawSettings(speed=session.settings.plan_speed))
    q_end, s_end = delivery.trajectory.q[-1], delivery.replay.final
    part = object_obstacles(belief.mjcf_path, s_end)
    pushed, _ = nearest_to_tip(session.arm, q_end, [o for o in part if o.name.startswith("part_")])
    direction = np.sign(request.s_target - s_initial) * belief.axis
    surroundings = cloud_obstacle(_unmodelled(belief, view, s_initial), name="surroundings")
    escape = plan_escape(
        session.arm,
        [*part, table_obstacle()],
        [*part, table_obstacle(), surroundings],
        q_end,
        session.arm.arm.q_home,
        direction,
        session.rng,
    )
    settings = session.settings
    motions = (
        Motion(delivery.trajectory, f"manipulation {number}"),
        timed(session, escape.out, f"manipulation {number}: out of contact", settings.push_speed),
        timed(session, escape.home, f"manipulation {number}: home", settings.travel_speed),
    )
    return PlannedManipulation(number, request, result, delivery, escape, motions, pushed)


def carry_out_manipulation(session: Session, planned: PlannedManipulation) -> tuple[Executed, ...]:
    """Execute the manipulation, the way out and the way home.

    Raises:
        ArmStoppedError: A protection stopped the arm.
    """
    return tuple(session.move(planned.motions))


def measure_now(
    session: Session, belief: Belief, name: str, s_expected: float
) -> tuple[Observation, Measurement]:
    """Look, and fit the part's state.

    Raises:
        EmptyCloudError, SceneError: The part is not seen.
    """
    view = observe(session, name)
    low, high = belief.model.range
    measured = measure_state(
        belief.template, view.capture.frame, view.arm_mask, (low - 0.03, high + 0.03), s_expected
    )
    return view, measured


def _plan(session: Session, belief: Belief, number: int, s_initial: float) -> tuple[PlanRequest, PlanResult]:
    """Plan with up to three seeds."""
    begun = time.monotonic()
    reasons = []
    for k in range(PLAN_TRIES):
        request = PlanRequest(
            arm=session.arm.arm,
            object_mjcf=belief.mjcf_path,
            s_initial=s_initial,
            s_target=session.settings.target_m,
            q_initial=session.status().q_ref,
            seed=session.settings.seed + 1000 * number + k,
        )
        result = plan_manipulation(request)
        if result.success:
            return request, result
        reasons.append(result.reason)
    raise TargetError(
        f"no plan moves the drawer from {s_initial:+.4f} to {session.settings.target_m:+.4f} m "
        f"({PLAN_TRIES} tries, {time.monotonic() - begun:.1f} s): {reasons[-1]}; try another target or placement"
    )


def _unmodelled(belief: Belief, view: Observation, s: float) -> np.ndarray:
    """Observed points that belong to no piece of the model at joint value s: other things on the table, (n, 3)."""
    p = view.scene.p_base
    near = np.zeros(len(p), bool)
    for piece in belief.model.pieces:
        X = piece.X_base_piece
        moved = s * belief.axis if piece.body == "part" else np.zeros(3)
        local = (p - X[:3, 3] - moved) @ X[:3, :3]
        low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        near |= np.all((local > low - OWN_REACH_M) & (local < high + OWN_REACH_M), axis=1)
    return p[~near]
