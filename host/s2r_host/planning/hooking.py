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

import mujoco
import numpy as np

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hand_probe import HandProbe
from s2r_host.planning.hook import Hook
from s2r_host.planning.out_of_reach import OutOfReachError, hull_hint, not_reached, refuse_far
from s2r_host.planning.patience import Patience
from s2r_host.planning.places import Places, find_places, part_box, tightness
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
    settings want, those are taken that it fits at.

    Raises:
        OutOfReachError: There is no free place behind the part, or the arm reaches none of them.
        TimeIsUpError: The time limit has passed.
    """
    patience = patience or Patience()
    name = Path(object_mjcf).name
    refuse_far(scene, world, name)
    if settings.apart_m > 0.0:
        try:
            return _hooks_apart(
                scene, world, name, s_target, settings, settings.apart_m, patience, leave=leave
            )
        except OutOfReachError as error:
            logger.info("not with %.0f mm around the robot: %s", 1e3 * settings.apart_m, error)
    return _hooks_apart(scene, world, name, s_target, settings, 0.0, patience, leave=leave)


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
) -> list[Hook]:
    """Places that leave some distance between robot and all but fingertip and part, best first, at least one."""
    probe = HandProbe(scene, world.data, settings.threads)
    sign = float(np.sign(s_target - world.s))
    why = (
        f"the fingertip fits nowhere behind the part that joint {scene.joint!r} moves towards s = {s_target:.3f}; "
        "is there a gap behind the handle?"
    )
    ways: list[Hook] = []
    for points, coming, listed in _SEARCHES:
        if coming != "usual" and ways:
            break
        patience.check(f"looking for places for the fingertip at {points} points")
        places = find_places(
            scene, world.data, probe, sign, points, ways=coming, room_m=settings.room_m, deep=settings.deep
        )
        if not len(places):
            continue
        solver = Postures(scene, world, places, s_target, settings, leave=leave, apart_m=apart_m)
        order = ranked_places(scene, world, places, settings.room_m, listed)
        hooks = _cheapest(scene, world, solver, places, order)
        patience.check(f"looking for a free way to {len(hooks)} postures")
        ways = solver.with_approach(_apart(hooks), settings.hooks) or ways
        if len(ways) >= settings.hooks and all(
            np.linalg.norm(way.push_part) >= _ROOMY * settings.room_m for way in ways
        ):
            break
        why = not_reached(scene, places, solver.failure(len(order), len(hooks), s_target))
    if not ways:
        raise OutOfReachError(f"object {name}: {why}{hull_hint(scene)}")
    return ways


def ranked_places(scene: Scene, world: FineWorld, places: Places, room_m: float, most: int) -> np.ndarray:
    """Indices of up to ``most`` places that differ from each other, the likeliest first."""
    return _different(places, np.argsort(_scores(scene, world.data, places, room_m), kind="stable"), most)


def _cheapest(
    scene: Scene, world: FineWorld, solver: Postures, places: Places, order: np.ndarray
) -> list[Hook]:
    """Hooks at the places in the given order, the cheapest first; a few of them, if it has that many."""
    found: list[tuple[float, Hook]] = []
    first, rest = order[:_FIRST], order[_FIRST:]
    for some, seeds in ((first, near_seeds), (rest, near_seeds), (order, far_seeds)):
        if len(some):
            found += solver.hooks(some, seeds(scene, world.q, places.p[some]))
        if len(found) >= _ENOUGH:
            break
    found.sort(key=lambda entry: entry[0])
    logger.debug("%d joint solutions at %d places", len(found), len(order))
    return [hook for _, hook in found[:_RANKED]]


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


def _scores(scene: Scene, data: mujoco.MjData, places: Places, room_m: float) -> np.ndarray:
    """Cost before any inverse kinematics, (n,): turning, way, tightness, off-centre for slides, short levers."""
    p_now = data.site_xpos[scene.tool_site]
    R_now = data.site_xmat[scene.tool_site].reshape(3, 3)
    cosine = (np.einsum("nij,ij->n", places.R, R_now) - 1.0) / 2.0
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    way = np.linalg.norm(places.p - p_now, axis=1)
    if scene.prismatic:
        low, high = part_box(scene, data)
        centre = (low + high)[:2] / 2.0
        leverage = 4.0 * np.linalg.norm(places.p[:, :2] - centre, axis=1)
    else:
        leverage = -8.0 * scene.lever(data, places.p)
    return turn + 2.0 * way + leverage + tightness(places, room_m)


def _different(places: Places, order: np.ndarray, most: int) -> np.ndarray:
    """The order without places that are nearly the same as an earlier one: neighbours share their fate."""
    p, R = places.p[order], places.R[order].reshape(-1, 9)
    left = np.arange(len(order))
    taken: list[int] = []
    while len(left) and len(taken) < most:
        first, left = left[0], left[1:]
        taken.append(int(order[first]))
        near = np.flatnonzero(np.square(p[left] - p[first]).sum(axis=1) < 0.02**2)
        left = np.delete(left, near[R[left[near]] @ R[first] > 2.9])
    return np.array(taken, dtype=int)
