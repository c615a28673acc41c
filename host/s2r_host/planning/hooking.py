"""Where the fingertip should push the part: a free place on the side that faces away from the wanted motion.

The paper measures the distance to the part's centre. For a drawer that has to be pulled, the centre lies inside the
front, and the nearest reachable place is in front of the handle, where nothing can be pulled. So a floating copy of
the hand is tried, without physics, at many places around the part: a place is good when the hand is free there, the
fingertip alone meets the part when it goes a little along the part's motion, the hand can back out along its own
axis, and the whole arm has a collision-free joint solution there, both at the start and at the target.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hand_probe import HandProbe
from s2r_host.planning.hook import Hook
from s2r_host.planning.out_of_reach import OutOfReachError, hull_hint, not_reached, refuse_far
from s2r_host.planning.patience import Patience
from s2r_host.planning.places import Places, PlaceSearch
from s2r_host.planning.postures import Postures, far_seeds, near_seeds
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings

logger = logging.getLogger(__name__)

# Searches in turn, each only where the ones before found too little: points looked at, oblique ways into a gap too,
# places listed. Many points matter between the posts of a short handle; oblique ways cost as much again.
_SEARCHES = ((30, "usual", 200), (90, "usual", 200), (500, "oblique", 600), (200, "upward", 200))
_ROOMY = (
    0.5  # of the way to the touch that is wished for; where some hooks have less, more places are looked at
)
_FIRST, _RANKED = 24, 40  # places tried first; joint solutions worth a closer look
_ENOUGH = 6  # hooks at which no further joint solutions are looked for


def find_hooks(
    scene: Scene,
    world: FineWorld,
    object_mjcf: str | Path,
    s_target: float,
    settings: PlanSettings,
    *,
    leave: bool = False,
    patience: Patience | None = None,
) -> list[Hook]:
    """Places for the fingertip to move the part from its present state to ``s_target``, best first, at least one.

    With ``leave`` the fingertip must be free to let go there. Where no place leaves the robot the distance that the
    settings want, or no way there keeps clear of where the part's edges may be, those are taken that it fits at.

    Raises:
        OutOfReachError: There is no free place behind the part, or the arm reaches none of them.
        TimeIsUpError: The time limit has passed.
    """
    patience = patience or Patience()
    name = Path(object_mjcf).name
    refuse_far(scene, world, name)
    rims = bool(scene.rims.any())
    roomier = [(settings.apart_m, rims)] if settings.apart_m > 0.0 else []
    roomier += [(0.0, True)] if rims else []
    for apart_m, clear in roomier:
        try:
            return _hooks_apart(
                scene, world, name, s_target, settings, apart_m, patience, leave=leave, rims=clear
            )
        except OutOfReachError as error:
            logger.info(
                "not with %.0f mm around the robot%s: %s", 1e3 * apart_m, ", clear of edges" * clear, error
            )
    return _hooks_apart(scene, world, name, s_target, settings, 0.0, patience, leave=leave, rims=False)


def _hooks_apart(
    scene: Scene,
    world: FineWorld,
    name: str,
    s_target: float,
    settings: PlanSettings,
    apart_m: float,
    patience: Patience,
    *,
    leave: bool,
    rims: bool,
) -> list[Hook]:
    """Places that leave some distance between robot and all but fingertip and part, best first, at least one."""
    probe = HandProbe(scene, world.data, settings.threads)
    sign = float(np.sign(s_target - world.s))
    why = (
        f"the fingertip fits nowhere behind the part that joint {scene.joint!r} moves towards s = {s_target:.3f}; "
        "is there a gap behind the handle?"
    )
    ways: list[Hook] = []
    missed: list[tuple[Postures, Places, str]] = []  # what each search looked at, and why that led nowhere
    for points, coming, listed in _SEARCHES:
        if coming != "usual" and ways:
            break
        patience.check(f"looking for places for the fingertip at {points} points")
        search = PlaceSearch(
            scene, world.data, probe, sign, points,
            ways=coming, room_m=settings.room_m, deep=settings.deep, missed=settings.missed,
            proven=settings.proven,
        )  # fmt: skip
        first = search.take(_FIRST)
        if not len(first):
            continue
        solver = Postures(scene, world, s_target, settings, leave=leave, apart_m=apart_m, rims=rims)
        hooks, places = _cheapest(scene, world, solver, search, first, listed)
        patience.check(f"looking for a free way to {len(hooks)} postures")
        ways = solver.with_approach(_apart(hooks), settings.hooks) or ways
        if len(ways) >= settings.hooks and all(
            np.linalg.norm(way.push_part) >= _ROOMY * settings.room_m for way in ways
        ):
            break
        missed.append((solver, places, solver.failure(len(places), len(hooks), s_target)))
    if missed and not ways:
        nearer = [step for solver, places, _ in missed if (step := solver.nearer_m(places)) is not None]
        why = not_reached(scene, *missed[-1][1:], min(nearer, default=None))
    if not ways:
        raise OutOfReachError(f"object {name}: {why}{hull_hint(scene)}")
    return ways


def _cheapest(
    scene: Scene, world: FineWorld, solver: Postures, search: PlaceSearch, first: Places, most: int
) -> tuple[list[Hook], Places]:
    """Hooks at the first places, at up to ``most`` where those give too few, the cheapest first, and all places."""
    found = solver.hooks(first, near_seeds(scene, world.q, first.p))
    places = first
    if len(found) < _ENOUGH:
        rest = search.take(most - len(first))
        found += solver.hooks(rest, near_seeds(scene, world.q, rest.p))
        places = Places.all_of([first, rest])
    if len(found) < _ENOUGH:
        found += solver.hooks(places, far_seeds(scene, places.p))
    found.sort(key=lambda entry: entry[0])
    logger.debug("%d joint solutions at %d places", len(found), len(places))
    return [hook for _, hook in found[:_RANKED]], places


def _apart(hooks: list[Hook]) -> list[Hook]:
    """The hooks in an order in which the first few are not neighbours of each other."""
    first, later = [], []
    for hook in hooks:
        near = any(
            np.linalg.norm(hook.p_part - other.p_part) < 0.015 and np.abs(hook.q - other.q).max() < 0.5
            for other in first
        )
        (later if near else first).append(hook)
    return first + later
