"""The kinds of object the stand-in knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_sim.objects.drawer import DrawerSpec, add_drawer, draw_drawer

# One more kind: a union of parameter sets, told apart by their `kind` (pydantic discriminator).
ObjectSpec = DrawerSpec


@dataclass(frozen=True)
class Kind:
    """How one kind of object is drawn and built."""

    draw: Callable[[np.random.Generator], ObjectSpec]
    add: Callable[[mujoco.MjSpec, ObjectSpec], None]


KINDS: dict[str, Kind] = {"drawer": Kind(draw_drawer, add_drawer)}


def add_object(world: mujoco.MjSpec, spec: ObjectSpec) -> None:
    """Add an object of any kind to a world."""
    KINDS[spec.kind].add(world, spec)
