"""Which plans are tried for a manipulation, in which order, and which is taken."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import product

import numpy as np

from s2r_host.errors import TargetError
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.out_of_reach import OutOfReachError
from s2r_host.planning.patience import Patience, TimeIsUpError
from s2r_host.planning.planner import scene_of
from s2r_host.planning.reach import stops_on_the_way
from s2r_host.run.belief import Belief
from s2r_host.run.observe import Observation
from s2r_host.run.planned import PlannedManipulation, planned_once, request_for
from s2r_host.run.session import Session
from s2r_host.run.tries import FailedTry, Try, grouped
from s2r_host.trajectory.deliver import MotionHitsError
from s2r_protocol.exits import RefusedError

logger = logging.getLogger(__name__)

# Share of the usual doubt about the object, one per try. In the end a plan that only just holds is better than none:
# where the part then is will be seen, and there is nothing yet to spoil.
DOUBTS = (1.0, 1.0, 1.0, 0.5, 0.5, 0.25, 0.25, 0.0, 0.0, 0.0)
# A correction of a part that is nearly where it should be is worth less than what a daring one can spoil.
CORRECTION_DOUBTS = (1.0, 1.0, 1.0, 0.5, 0.5)
# Tries with the usual, quick plans, and control steps to turn a part in of those after them: quick ones may throw a
# part whose way is short, and do not end on target then once they are timed.
QUICK_TRIES, TURN_STEPS = 2, 24
STOP_DOUBTS, MOST_STOPS = (0.5, 0.0), 3  # of a plan that ends on the way
ROUGHLY = 0.15  # share of the way that a plan may miss the target by when none meets it
# Share of the way to go within which a fragile plan has to leave every object that is believable: so near that it is
# surely worth it, or at least no farther than the part is now.
SURELY_NEARER, NO_FARTHER = 0.5, 1.0


def prepare_manipulation(
    session: Session,
    belief: Belief,
    number: int,
    s_initial: float,
    view: Observation,
    show: Callable[[float], str],
) -> PlannedManipulation:
    """A plan that ends on target and that every believable object survives; where there is none, the next best.

    On failure it is planned again with other chance, then with less doubt about the object, until the tries or the
    time for them are used up.
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
    task, to_go = session.settings.task, abs(session.target - s_initial)
    on_target = _on_target(session.target, careful=number > 1 and to_go <= task.tolerance)
    plans = _Plans(session, lambda one: planned_once(session, belief, number, s_initial, view, one), number)
    quick, patient = on_target[:QUICK_TRIES], on_target[QUICK_TRIES:]
    planned = plans.first(quick, off_edges=True) or plans.at_edge or plans.first(patient)
    if planned is not None:
        return planned
    tried, why = len(plans.failed), grouped([one.reason for one in plans.failed])
    planned = plans.least_fragile(SURELY_NEARER * to_go, session.target)
    if planned is None and to_go > task.far_off:  # else a correction is worth less than what it may spoil
        plans.allow_time()
        planned = plans.first(_second_best(session, belief, s_initial))
    planned = planned or plans.least_fragile(NO_FARTHER * to_go, session.target)
    if planned is None:
        raise TargetError(
            f"no plan takes the {task.part} from {show(s_initial)} to {show(session.target)} "
            f"({tried} tries: {why}); try another target or placement"
        )
    if planned.delivery.fragile is None:
        told = f"all the way ({why}); first to {show(planned.foreseen)}"
    else:
        strays = task.unit.show(_farthest(planned, session.target))[1:]
        told = f"there whatever the object is like ({why}); one that ends at most {strays} from it is taken"
    session.journal.warn(f"no plan takes the {task.part} {told}")
    return planned


class _Plans:
    """What tries for one manipulation came to. Once a plan has hit something the further ones keep room.

    Chance has no part in where a fingertip fits: where it fits nowhere it is not tried again with the same doubt.

    Attributes:
        failed: Those without a plan that every believable object survives, with their reasons.
        fragile: The plans of those that have one which not every believable object survives.
        at_edge: The first plan that every one survives but that pushes the part at an edge, where it was to be avoided.
    """

    def __init__(self, session: Session, plan: Callable[[Try], PlannedManipulation], number: int) -> None:
        self.failed: list[FailedTry] = []
        self.fragile: list[PlannedManipulation] = []
        self.at_edge: PlannedManipulation | None = None
        self._hits = False
        self._out_of_reach: set[tuple[float, float, bool]] = set()
        self._plan, self._number, self._journal = plan, number, session.journal
        self._time_s = session.settings.plan_time_s
        self.allow_time()

    def allow_time(self) -> None:
        """From now on tries may be begun for as long as the settings say."""
        self._patience = Patience(self._time_s, self._journal.doing)

    def first(self, tries: Iterable[Try], *, off_edges: bool = False) -> PlannedManipulation | None:
        """Plan one try after the other until every believable object survives; what fails is kept.

        Args:
            tries: In order.
            off_edges: Plans that push the part at an edge are kept and not taken.
        """
        for asked in tries:
            one = replace(asked, apart=self._hits)
            places = (one.s_target, one.doubt, one.apart)
            if places in self._out_of_reach:
                continue
            try:
                self._patience.check(f"try {len(self.failed) + 1}")
            except TimeIsUpError as error:
                logger.info("%s", error)
                return None
            try:
                planned = self._plan(one)
            except RefusedError as error:
                reason = str(error)
                self._hits |= isinstance(error, MotionHitsError)
                if isinstance(error, OutOfReachError):
                    self._out_of_reach.add(places)
            else:
                fragile = planned.delivery.fragile
                if fragile is None and not (off_edges and planned.end.at_edge):
                    return planned
                reason = fragile or "it pushes the part at an edge"
                self._hits |= planned.delivery.hits
                if fragile is None:
                    self.at_edge = self.at_edge or planned
                else:
                    self.fragile.append(planned)
            logger.info("try %d to plan manipulation %d: %s", one.number + 1, self._number, reason)
            self.failed.append(FailedTry(self._number, one, reason))
            self._journal.failed_tries.append(self.failed[-1])
        return None

    def least_fragile(self, most: float, target: float) -> PlannedManipulation | None:
        """The fragile plan that strays least, where no believable object ends ``most`` from the target [m or rad]."""
        found = min(self.fragile, key=lambda one: _farthest(one, target), default=None)
        return found if found is not None and _farthest(found, target) < most else None


def _farthest(planned: PlannedManipulation, target: float) -> float:
    """How far from a target any believable object may end [m or rad]; a plan may be made for a stop on the way."""
    return planned.delivery.strays + abs(planned.request.s_target - target)


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
    request = request_for(session, belief, 0, s_initial, Try(0, session.target, STOP_DOUBTS[0]))
    scene = scene_of(request)
    world = FineWorld(scene, np.asarray(request.q_initial), s_initial)
    try:
        found = stops_on_the_way(scene, world, session.target, request.settings, slipped=True)
    except RefusedError as error:
        logger.info("states on the way to the target: %s", error)
        return []
    least = session.settings.task.far_off
    return [stop for stop in found if abs(stop - s_initial) > least][:MOST_STOPS]
