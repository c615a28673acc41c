"""From place to place: the search for stops on the way that one leg reaches and another goes on from."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from s2r_host.errors import HostError
from s2r_host.planning.out_of_reach import OutOfReachError
from s2r_host.planning.part_alone import is_coupled
from s2r_host.planning.patience import Patience, TimeIsUpError
from s2r_host.planning.planner import world_of
from s2r_host.planning.reach import stops_on_the_way
from s2r_host.planning.scene import Scene
from s2r_host.planning.staying import drift
from s2r_host.planning.task import PlanRefusedError, PlanRequest, PlanResult
from s2r_host.trajectory.deliver import SEED_STEP, Delivery, apart, cannot_stay, plan_trajectory
from s2r_host.trajectory.legs_joined import Leg, LeggedPlan, together
from s2r_host.trajectory.retreat import retreat
from s2r_host.trajectory.time_law import TimeLawSettings
from s2r_host.trajectory.trajectory import TrajectoryError

logger = logging.getLogger(__name__)

NO_PLAN = (OutOfReachError, PlanRefusedError, TrajectoryError)
_MOST_LEGS = 8
_MOST_TRIED = 16  # legs planned until the search for a way is given up
_CALMER_TRIED = 5  # legs planned in search of a calmer plan when a fragile one has been found
_STAGES = 2
_LEAST_BANDS = 10.0  # success bands that a leg has to bring the part nearer to the target


def cheaply(request: PlanRequest) -> PlanRequest:
    """The same task for the cascade's cheap stages alone: where they fail, a stop on the way is the better next try."""
    return replace(request, settings=replace(request.settings, cascade=request.settings.cascade[:_STAGES]))


def calmest(search: LegSearch, request: PlanRequest, *, slipped: bool) -> LeggedPlan | None:
    """The first plan of several legs that stands up to slightly different objects; else the first that holds."""
    second_best: LeggedPlan | None = None
    try:
        for legs in search.onward(request, _MOST_LEGS, slipped=slipped):
            try:
                whole = together(request, search.scene, legs)
            except NO_PLAN as error:
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
                search.only_calm(_CALMER_TRIED, apart=whole.delivery.hits)
    except TimeIsUpError:
        if second_best is None:
            raise
    return second_best


class LegSearch:
    """Depth first: the longest first leg that something can follow."""

    def __init__(self, settings: TimeLawSettings | None, scene: Scene, patience: Patience) -> None:
        self._settings, self.scene, self._patience = settings, scene, patience
        self._left, self._fragile_too, self._apart = _MOST_TRIED, True, False
        self.problem: str | None = None

    def only_calm(self, count: int, *, apart: bool) -> None:
        """Plan no more than so many further legs, none that is fragile; ``apart``: with room around the robot."""
        self._left, self._fragile_too, self._apart = min(self._left, count), False, apart

    def onward(self, request: PlanRequest, most: int, *, slipped: bool) -> Iterator[list[Leg]]:
        """Legs from where a request begins to its target, at least two and at most ``most``, one way after another."""
        world = world_of(request, self.scene)
        stops = stops_on_the_way(
            self.scene, world, request.s_target, request.settings, slipped=slipped, patience=self._patience
        )
        logger.info("from s = %.3f: stops at %s", request.s_initial, np.round(stops, 3))
        for s_stop in stops:
            task = replace(request, s_target=s_stop, leave=True)
            leg = self._leg(task)
            if leg is None:
                continue
            yield from self._followed(leg, request, most)
            if leg.delivery.hits and self._apart:
                again = self._leg(task)
                if again is not None:
                    yield from self._followed(again, request, most)

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
                cheaply(apart(request) if self._apart else request),
                self._settings,
                1,
                scene=self.scene,
                patience=self._patience,
                accept_fragile=self._fragile_too,
            )
        except TimeIsUpError:
            raise
        except NO_PLAN as error:
            self._note(error)
            return error

    def _note(self, error: HostError) -> None:
        logger.info("leg: %s", error)
        self.problem = str(error)
