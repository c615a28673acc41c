"""The kinds of object the stand-in knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import numpy as np
from pydantic import Field

from s2r_sim.errors import WorldFileError
from s2r_sim.objects.chest import ChestSpec, add_chest, draw_chest, draw_drawers, other_drawers
from s2r_sim.objects.dial import DialSpec, add_dial, draw_dial
from s2r_sim.objects.door import DoorSpec, add_door, draw_door
from s2r_sim.objects.drawer import DrawerSpec, add_drawer, draw_drawer
from s2r_sim.objects.faucet import FaucetSpec, add_faucet, draw_faucet
from s2r_sim.objects.laptop import LaptopSpec, add_laptop, draw_laptop
from s2r_sim.objects.lid import LidSpec, add_lid, draw_lid
from s2r_sim.objects.naming import JOINT

ObjectSpec = Annotated[
    DrawerSpec | ChestSpec | LaptopSpec | FaucetSpec | DoorSpec | LidSpec | DialSpec,
    Field(discriminator="kind"),
]


@dataclass(frozen=True)
class Kind:
    """How one kind of object is drawn and built.

    Attributes:
        draw: Draws its hidden parameters.
        add: Adds it to a world.
        category: The kind of task it stands for: drawer, laptop, faucet, door, lid or dial.
        slides: Its joint is prismatic.
    """

    draw: Callable[[np.random.Generator], Any]
    add: Callable[[mujoco.MjSpec, Any], None]
    category: str
    slides: bool = False


KINDS: dict[str, Kind] = {
    "drawer": Kind(draw_drawer, add_drawer, "drawer", slides=True),
    "chest": Kind(draw_chest, add_chest, "drawer", slides=True),
    "laptop": Kind(draw_laptop, add_laptop, "laptop"),
    "faucet": Kind(draw_faucet, add_faucet, "faucet"),
    "door": Kind(draw_door, add_door, "door"),
    "lid": Kind(draw_lid, add_lid, "lid"),
    "dial": Kind(draw_dial, add_dial, "dial"),
    "drawers": Kind(draw_drawers, add_chest, "drawer", slides=True),
}


def kind_named(name: str) -> Kind:
    """The kind of that name.

    Raises:
        WorldFileError: There is none.
    """
    if name not in KINDS:
        raise WorldFileError(f"unknown kind of object {name!r}; known are {', '.join(KINDS)}")
    return KINDS[name]


def add_object(world: mujoco.MjSpec, spec: ObjectSpec) -> None:
    """Add an object of any kind to a world."""
    KINDS[spec.kind].add(world, spec)


def states_as_found(spec: ObjectSpec) -> dict[str, float]:
    """Joint value as found of every part that moves [m or rad], by joint name, the part told of first."""
    return {JOINT: spec.q_start} | (other_drawers(spec) if isinstance(spec, ChestSpec) else {})
