"""What concealed worlds hide beyond friction and joints: bodies that give way where the host believes them rigid.

Every concealed lid bends a little, every drawer has clearance in its rail, every arm elastic gears. Drawn from streams
of their own, so that the object of a number keeps its place, its size and its friction whatever is added here.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from s2r_protocol.arms import ArmDescription, load_arm
from s2r_sim.objects.drawer import DrawerSpec, draw_slop
from s2r_sim.objects.laptop import LaptopSpec, draw_bend
from s2r_sim.world import WorldSpec, draw_gears

_SALT = 81


def conceal(world: WorldSpec, kind: int, number: int, arm: ArmDescription | None = None) -> WorldSpec:
    """The world with these effects.

    Args:
        world: Drawn without them.
        kind, number: Of the trial; the same give the same effects.
        arm: Whose gears give way; None: the xMate3Pro.
    """
    rng_object, rng_arm = np.random.default_rng([_SALT, kind, number]).spawn(2)
    spec, gears = world.object, draw_gears(rng_arm, arm or _xmate())
    if isinstance(spec, LaptopSpec):
        spec = spec.model_copy(update={"bend": draw_bend(rng_object, spec)})
    elif isinstance(spec, DrawerSpec):
        spec = spec.model_copy(update={"slop": draw_slop(rng_object)})
    return world.model_copy(update={"object": spec, "arm": world.arm.model_copy(update={"gears": gears})})


@cache
def _xmate() -> ArmDescription:
    return load_arm("xmate3pro")
