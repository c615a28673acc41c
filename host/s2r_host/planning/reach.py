"""How far single places could carry a part: where a plan may stop on its way and go on from another place."""

from __future__ import annotations

import numpy as np

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hand_probe import HandProbe
from s2r_host.planning.patience import Patience
from s2r_host.planning.places import PlaceSearch
from s2r_host.planning.postures import Postures, far_seeds, near_seeds
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings

# Points looked at, oblique ways into a gap too, places listed; the second search where the first finds nothing.
_SEARCHES = ((90, "usual", 200), (500, "oblique", 600))
_STEP_M, _STEP_RAD, _STEPS = 0.025, 0.08, (4, 40)  # between states looked at; least and most of them
_SOME = 0.2  # of the most places that reach any state: fewer are left for when nothing else helps
_SHORTER = (1.0, 0.75, 0.5, 0.3)  # of the farthest state, in the order in which they are worth trying
_TRUSTED = 0.6  # of the way, where a plan all the way has failed though the arm could go along


def stops_on_the_way(
    scene: Scene,
    world: FineWorld,
    s_target: float,
    settings: PlanSettings,
    *,
    slipped: bool = False,
    patience: Patience | None = None,
) -> list[float]:
    """States between the present one and the target that one place could carry the part to and leave it at.

    The farthest first, then less far ones, which other places may go on from. Kinematics and free space alone: whether
    the part stays there and a plan holds is for others to find out. ``slipped``: a plan all the way has failed though
    the arm could go along; then no stop near the target is worth trying.
    """
    states, counts = _carried(scene, world, s_target, settings, patience or Patience())
    if slipped:
        counts[round(_TRUSTED * len(counts)) :] = 0
    if not counts.any():
        return []
    far = np.flatnonzero(counts >= _SOME * counts.max())[-1]
    wanted = [_nearest(counts, share * (far + 1.0) - 1.0) for share in _SHORTER]
    farthest = int(np.flatnonzero(counts)[-1])
    return [float(states[row]) for row in dict.fromkeys((*wanted, farthest))]


def _nearest(counts: np.ndarray, row: float) -> int:
    """The row nearest to a wanted one that any place gets to."""
    rows = np.flatnonzero(counts)
    return int(rows[np.abs(rows - row).argmin()])


def _carried(
    scene: Scene, world: FineWorld, s_target: float, settings: PlanSettings, patience: Patience
) -> tuple[np.ndarray, np.ndarray]:
    """States on the way, the target left out, (n,), and how many postures at places get each of them there, (n,)."""
    way = s_target - world.s
    step = _STEP_M if scene.prismatic else _STEP_RAD
    count = int(np.clip(np.ceil(abs(way) / step), *_STEPS))
    states = world.s + way * np.arange(1, count) / count
    probe = HandProbe(scene, world.data, settings.threads)
    counts = np.zeros(len(states), dtype=int)
    for points, coming, listed in _SEARCHES:
        patience.check(f"looking for places to go on from, s = {world.s:.3f}")
        places = PlaceSearch(scene, world.data, probe, float(np.sign(way)), points, ways=coming).take(listed)
        if len(places):
            postures = Postures(scene, world, s_target, settings)
            seeds = near_seeds(scene, world.q, places.p) + far_seeds(scene, places.p)
            counts = postures.carried(places, seeds, states)
        if counts.any():
            break
    return states, counts
