"""What concealed objects hide beyond friction and joints: bodies that give way where the host believes them rigid.

Every concealed lid bends a little, every drawer has clearance in its rail. Drawn from streams of their own, so that the
object of a number keeps its place, its size and its friction whatever is added here.
"""

from __future__ import annotations

import numpy as np

from s2r_sim.objects.drawer import DrawerSpec, draw_slop
from s2r_sim.objects.laptop import LaptopSpec, draw_bend
from s2r_sim.world import WorldSpec

_SALT = 81


def conceal(world: WorldSpec, kind: int, number: int) -> WorldSpec:
    """The world with these effects.

    Args:
        world: Drawn without them.
        kind, number: Of the trial; the same give the same effects.
    """
    rng = np.random.default_rng([_SALT, kind, number])
    spec = world.object
    if isinstance(spec, LaptopSpec):
        spec = spec.model_copy(update={"bend": draw_bend(rng, spec)})
    elif isinstance(spec, DrawerSpec):
        spec = spec.model_copy(update={"slop": draw_slop(rng)})
    return world.model_copy(update={"object": spec})
