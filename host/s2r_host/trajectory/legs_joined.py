"""Legs put together: one motion, replayed from the start and tried with slightly different objects as any other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRefusedError, PlanRequest, PlanResult
from s2r_host.trajectory.deliver import Delivery, judged
from s2r_host.trajectory.perturb import perturbed
from s2r_host.trajectory.retreat import Retreat
from s2r_host.trajectory.trajectory import Trajectory
from s2r_host.trajectory.verify import replay


@dataclass(frozen=True, eq=False)
class Leg:
    """One place's share of a plan.

    Attributes:
        request: Its task: where it begins and ends.
        result: Its plan.
        delivery: Its timed motion, from where it begins.
        left: The way out after it; None for the last leg, which holds the target.
        start_s, end_s: When its motion begins and ends in the whole one; the way out follows.
    """

    request: PlanRequest
    result: PlanResult
    delivery: Delivery
    left: Retreat | None = None
    start_s: float = 0.0
    end_s: float = 0.0


@dataclass(frozen=True, eq=False)
class LeggedPlan:
    """A motion of one or several legs that the fine model has followed to the target.

    Attributes:
        legs: In order, at least one.
        delivery: The whole motion; with one leg it is that leg's.
    """

    legs: tuple[Leg, ...]
    delivery: Delivery


def together(request: PlanRequest, scene: Scene, legs: list[Leg]) -> LeggedPlan:
    """The legs as one motion, replayed from the start.

    Raises:
        PlanRefusedError: The whole does not hold the target, or touches or takes too much on its way.
    """
    pause_s = request.settings.hold_s
    placed: list[Leg] = []
    motions: list[Trajectory] = []
    now_s = 0.0
    for leg in legs:
        motion = leg.delivery.trajectory
        placed.append(replace(leg, start_s=now_s, end_s=now_s + motion.duration_s))
        for piece in (motion, leg.left.trajectory if leg.left is not None else None):
            if piece is not None:
                motions.append(piece)
                now_s += piece.duration_s + pause_s
    whole = _one_after_another(motions, pause_s)
    played = replay(whole, request, scene)
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    problem = played.problem(tolerance, request.settings)
    if problem is not None:
        raise PlanRefusedError(f"the legs together: {problem}")
    last = legs[-1].delivery
    speed = min(leg.delivery.speed for leg in legs)
    delivery = Delivery(whole, played, sum(leg.delivery.corrections for leg in legs), last.followed, speed)
    beliefs = perturbed(request.settings.doubt, scene.axis_at_rest())
    return LeggedPlan(tuple(placed), judged(delivery, request, scene, beliefs))


def _one_after_another(motions: list[Trajectory], pause_s: float) -> Trajectory:
    """Motions that begin where the one before ended, at rest, with pauses between."""
    t, start_s = [], 0.0
    for motion in motions:
        t.append(motion.t + start_s)
        start_s += motion.duration_s + pause_s
    return Trajectory(
        np.concatenate(t),
        np.concatenate([motion.q for motion in motions]),
        np.concatenate([motion.dq for motion in motions]),
        np.concatenate([motion.ddq for motion in motions]),
    )
