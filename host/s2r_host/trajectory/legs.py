"""Plans of several legs: the part is carried some way, left there, and carried on from another place.

A door that is pulled open by its handle is pushed on from its inner face; a wheel is turned spoke by spoke. Where one
place carries the part the whole way nothing of this runs. Else the plan goes to a state that one place reaches and
at which the part stays, the fingertip lets go and backs out, and the rest is planned from there, in the state that the
fine model is then in. The legs are put together to one motion, and that is replayed from the start as any other.
"""

from __future__ import annotations

import logging
from dataclasses import replace

from s2r_host.errors import HostError
from s2r_host.planning.out_of_reach import NeverInReachError, OutOfReachError
from s2r_host.planning.patience import Patience
from s2r_host.planning.planner import is_possible, scene_of
from s2r_host.planning.scene import Scene
from s2r_host.planning.staying import creeping
from s2r_host.planning.task import PlanRequest
from s2r_host.trajectory.deliver import SEED_STEP, plan_trajectory
from s2r_host.trajectory.legs_joined import Leg, LeggedPlan
from s2r_host.trajectory.legs_search import NO_PLAN, LegSearch, calmest, cheaply
from s2r_host.trajectory.time_law import TimeLawSettings

logger = logging.getLogger(__name__)

_ATTEMPTS = 3  # seeds tried from one place
_FAR_M, _FAR_RAD = 0.2, 0.8  # ways on which one place is soon given up


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
    except NO_PLAN as error:
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
        return from_one_place(cheaply(request) if far else request, _ATTEMPTS, only_fragile=True)
    except NeverInReachError:
        raise
    except NO_PLAN as error:
        if not is_possible(request, scene):
            raise
        first = error
    logger.info("not from one place: %s", first)
    search = LegSearch(settings, scene, patience)
    slipped = not isinstance(first, OutOfReachError)
    found = calmest(search, request, slipped=slipped)
    if found is not None and (accept_fragile or found.delivery.fragile is None):
        return found
    problem = search.problem if found is None else found.delivery.fragile
    if not slipped:
        raise _with_legs(first, problem) from first
    last = replace(request, settings=replace(request.settings, along_route=True))
    try:  # what a single place has not been asked yet: the expensive stages, or other seeds, and the route itself
        if far:
            return from_one_place(last, _ATTEMPTS, only_found=True)
        again = replace(last, seed=request.seed + SEED_STEP)
        return from_one_place(again, _ATTEMPTS - 1, only_found=True)
    except NO_PLAN as error:
        raise _with_legs(error, problem) from error


def _with_legs(first: HostError, problem: str | None) -> HostError:
    """The reason why one place does not do, and what became of the legs."""
    if problem is None:
        return first
    return type(first)(f"{first}; nor in several legs: {problem}")
