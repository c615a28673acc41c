"""Plans of several legs: the part is carried some way, left there, and carried on from another place.

A door that is pulled open by its handle is pushed on from its inner face; a wheel is turned spoke by spoke. Where one
place carries the part the whole way nothing of this runs. Else the plan goes to a state that one place reaches and
at which the part stays, the fingertip lets go and backs out, and the rest is planned from there, in the state that the
fine model is then in. The legs are put together to one motion, and that is replayed from the start as any other.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from s2r_host.errors import HostError
from s2r_host.planning.door import creeping, drift, is_coupled
from s2r_host.planning.out_of_reach import NeverInReachError, OutOfReachError
from s2r_host.planning.patience import Patience, TimeIsUpError
from s2r_host.planning.planner import is_possible, scene_of, world_of
from s2r_host.planning.reach import stops_on_the_way
from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRefusedError, PlanRequest, PlanResult
from s2r_host.trajectory.deliver import SEED_STEP, Delivery, cannot_stay, fragility, plan_trajectory
from s2r_host.trajectory.perturb import perturbed
from s2r_host.trajectory.retreat import Retreat, retreat
from s2r_host.trajectory.time_law import TimeLawSettings
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError
from s2r_host.trajectory.verify import replay

logger = logging.getLogger(__name__)

_MOST_LEGS = 8
_MOST_TRIED = 16  # legs planned until the search for a way is given up
_CALMER_TRIED = 5  # legs planned in search of a calmer plan when a fragile one has been found
_ATTEMPTS = 3  # seeds tried from one place
_FAR_M, _FAR_RAD = 0.2, 0.8  # ways on which one place is soon given up
_STAGES = 2
_LEAST_BANDS = 10.0  # success bands that a leg has to bring the part nearer to the target
_NO_PLAN = (OutOfReachError, PlanRefusedError, TrajectoryError)


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


def plan_legs(
    request: PlanRequest,
    settings: TimeLawSettings | None = None,
    *,
    scene: Scene | None = None,
    patience: Patience | None = None,
    accept_fragile: bool = False,
) -> LeggedPlan:
    """Plan and deliver as :func:`plan_trajectory` does; where one place does not do, from one place after another.

    Args:
        request: The task.
        settings: Of the time law.
        scene: The request's scene, if it has been built already.
        patience: A limit on the time, and who is told about progress.
        accept_fragile: See :func:`plan_trajectory`; the legs of a longer plan always may be, and the whole is judged.

    Raises:
        PlanRefusedError, OutOfReachError, TrajectoryError: No plan; the text says why no place carries the part the
            whole way, and what became of stopping on the way.
        SceneFileError, TimeIsUpError: As the planner says.
    """
    scene, patience = scene or scene_of(request), patience or Patience()
    try:
        return _planned(request, settings, scene, patience, accept_fragile=accept_fragile)
    except NeverInReachError:
        raise
    except _NO_PLAN as error:
        creeps = creeping(request, scene) if is_possible(request, scene) else None
        if creeps is None:
            raise
        raise type(error)(f"{error}; {creeps}") from error


def _planned(
    request: PlanRequest,
    settings: TimeLawSettings | None,
    scene: Scene,
    patience: Patience,
    *,
    accept_fragile: bool,
) -> LeggedPlan:
    """From one place, and where that does not do from several."""
    far = abs(request.s_target - request.s_initial) > (_FAR_M if scene.prismatic else _FAR_RAD)

    def from_one_place(
        task: PlanRequest, attempts: int, *, only_fragile: bool = False, only_found: bool = False
    ) -> LeggedPlan:
        result, delivery = plan_trajectory(
            task,
            settings,
            attempts,
            scene=scene,
            patience=patience,
            accept_fragile=accept_fragile,
            only_fragile=only_fragile,
            only_found=only_found,
        )
        leg = Leg(task, result, delivery, end_s=delivery.trajectory.duration_s)
        return LeggedPlan((leg,), delivery)

    try:
        return from_one_place(_quick(request) if far else request, _ATTEMPTS, only_fragile=True)
    except NeverInReachError:
        raise
    except _NO_PLAN as error:
        if not is_possible(request, scene):
            raise
        first = error
    logger.info("not from one place: %s", first)
    search = _Search(settings, scene, patience)
    slipped = not isinstance(first, OutOfReachError)
    found = _calmest(search, request, slipped=slipped)
    if found is not None and (accept_fragile or found.delivery.fragile is None):
        return found
    problem = search.problem if found is None else found.delivery.fragile
    if not slipped:
        raise _with_legs(first, problem) from first
    try:  # what a single place has not been asked yet: the expensive stages, or other seeds
        if far:
            return from_one_place(request, _ATTEMPTS, only_found=True)
        again = replace(request, seed=request.seed + SEED_STEP)
        return from_one_place(again, _ATTEMPTS - 1, only_found=True)
    except _NO_PLAN as error:
        raise _with_legs(error, problem) from error


def _quick(request: PlanRequest) -> PlanRequest:
    """The same task for the cascade's cheap stages alone: where they fail, a stop on the way is the better next try."""
    return replace(request, settings=replace(request.settings, cascade=request.settings.cascade[:_STAGES]))


def _with_legs(first: HostError, problem: str | None) -> HostError:
    """The reason why one place does not do, and what became of the legs."""
    if problem is None:
        return first
    return type(first)(f"{first}; nor in several legs: {problem}")


def _calmest(search: _Search, request: PlanRequest, *, slipped: bool) -> LeggedPlan | None:
    """The first plan of several legs that stands up to slightly different objects; else the first that holds."""
    second_best: LeggedPlan | None = None
    try:
        for legs in search.onward(request, _MOST_LEGS, slipped=slipped):
            try:
                whole = _together(request, search.scene, legs)
            except _NO_PLAN as error:
                search.problem = str(error)
                continue
            if whole.delivery.fragile is None:
                return whole
            logger.info("%d legs: %s", len(legs), whole.delivery.fragile)
            if whole.delivery.replay.contact_share > request.settings.contact_margin:
                return second_best or whole  # with the believed object: other legs need the same force
            if second_best is None:
                second_best = whole
                if cannot_stay(request, search.scene):
                    return whole
                search.only_calm(_CALMER_TRIED)
    except TimeIsUpError:
        if second_best is None:
            raise
    return second_best


class _Search:
    """Depth first: the longest first leg that something can follow."""

    def __init__(self, settings: TimeLawSettings | None, scene: Scene, patience: Patience) -> None:
        self._settings, self.scene, self._patience = settings, scene, patience
        self._left, self._fragile_too = _MOST_TRIED, True
        self.problem: str | None = None

    def only_calm(self, count: int) -> None:
        """Plan no more than so many further legs, and take none that is fragile."""
        self._left, self._fragile_too = min(self._left, count), False

    def onward(self, request: PlanRequest, most: int, *, slipped: bool) -> Iterator[list[Leg]]:
        """Legs from where a request begins to its target, at least two and at most ``most``, one way after another."""
        world = world_of(request, self.scene)
        stops = stops_on_the_way(
            self.scene, world, request.s_target, request.settings, slipped=slipped, patience=self._patience
        )
        logger.info("from s = %.3f: stops at %s", request.s_initial, np.round(stops, 3))
        for s_stop in stops:
            leg = self._leg(replace(request, s_target=s_stop, leave=True))
            if leg is not None:
                yield from self._followed(leg, request, most)

    def _followed(self, leg: Leg, request: PlanRequest, most: int) -> Iterator[list[Leg]]:
        """A leg with what may come after it."""
        if leg.left is None:
            return
        rest = replace(request, q_initial=leg.left.q, s_initial=leg.left.s, others=leg.left.others)
        if abs(request.s_target - rest.s_initial) > abs(request.s_target - request.s_initial):
            return
        for further in self._rest(rest, most - 1):
            yield [leg, *further]

    def _leg(self, request: PlanRequest) -> Leg | None:
        """A leg to a stop and the way out of it, or None."""
        scene, s_stop = self.scene, request.s_target
        tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
        if abs(s_stop - request.s_initial) < _LEAST_BANDS * tolerance or self._left <= 0:
            return None
        self._left -= 1
        falls = None if is_coupled(scene) else drift(request, scene, tolerance, s_stop)
        if falls is not None:
            self.problem = f"the part does not stay on the way, at s = {s_stop:.4f}: {falls}"
            return None
        found = self._planned(request)
        if isinstance(found, HostError):
            return None
        result, delivery = found
        try:
            left = retreat(delivery.trajectory, request, scene)
        except PlanRefusedError as error:
            self._note(error)
            return None
        return Leg(request, result, delivery, left)

    def _rest(self, request: PlanRequest, most: int) -> Iterator[list[Leg]]:
        """The last leg, or several more."""
        found = self._planned(request)
        if not isinstance(found, HostError):
            yield [Leg(request, *found)]
            if found[1].fragile is not None and self._left > 0:
                self._left -= 1
                again = self._planned(replace(request, seed=request.seed + SEED_STEP))
                if not isinstance(again, HostError):
                    yield [Leg(request, *again)]
        elif most < 2:
            self.problem = f"more than {_MOST_LEGS} legs would be needed"
        else:
            yield from self.onward(request, most, slipped=not isinstance(found, OutOfReachError))

    def _planned(self, request: PlanRequest) -> tuple[PlanResult, Delivery] | HostError:
        """The plan of a leg, by the cascade's cheap stages, or why there is none."""
        self._patience.check(f"a leg from s = {request.s_initial:.3f} to {request.s_target:.3f}")
        try:
            return plan_trajectory(
                _quick(request),
                self._settings,
                1,
                scene=self.scene,
                patience=self._patience,
                accept_fragile=self._fragile_too,
            )
        except TimeIsUpError:
            raise
        except _NO_PLAN as error:
            self._note(error)
            return error

    def _note(self, error: HostError) -> None:
        logger.info("leg: %s", error)
        self.problem = str(error)


def _together(request: PlanRequest, scene: Scene, legs: list[Leg]) -> LeggedPlan:
    """The legs as one motion, replayed from the start."""
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
    fragile = fragility(delivery, request, scene, beliefs)
    return LeggedPlan(tuple(placed), replace(delivery, fragile=fragile))


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
