"""Random tasks: nine manipulations of four kinds of objects, each at any number of placements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from s2r_host.planning.sample_objects import (
    DoorShape,
    door_mjcf,
    drawer_mjcf,
    faucet_mjcf,
    lid_mjcf,
    random_drawer,
)

TASKS = (
    "drawer_open",
    "drawer_close",
    "laptop_open",
    "laptop_close",
    "faucet_left",
    "faucet_right",
    "door_open",
    "door_close",
    "drawer_far",
)
FAR_M = (1.16, 1.24)  # where the front of a drawer stands that the bare gripper cannot open


@dataclass(frozen=True)
class BenchTask:
    """One manipulation of one object: the file's text, its joint's start and target [m or rad]."""

    name: str
    placement: int
    mjcf: str
    s_initial: float
    s_target: float

    def write(self, folder: Path) -> Path:
        """Write the object file."""
        path = folder / f"{self.name}_{self.placement}.xml"
        path.write_text(self.mjcf)
        return path


def draw_task(name: str, placement: int, collection: int = 0) -> BenchTask:
    """The task of that name at the placement of that number; collections never share a placement."""
    kind = TASKS.index(name)
    rng = np.random.default_rng([collection, kind // 2, placement])
    yaw = float(rng.uniform(-0.25, 0.25))
    if name == "drawer_far":
        shape = replace(random_drawer(rng), x=float(rng.uniform(*FAR_M)))
        return BenchTask(name, placement, drawer_mjcf(shape), 0.0, 0.08)
    if name.startswith("drawer"):
        shape = random_drawer(rng)
        start, way = (0.0, 0.10) if name.endswith("open") else (0.10, -0.10)
        return BenchTask(name, placement, drawer_mjcf(shape), start, start + way)
    x, y = float(rng.uniform(0.46, 0.56)), float(rng.uniform(-0.12, 0.12))
    if name.startswith("laptop"):
        opening = float(rng.uniform(0.8, 1.3))
        text = lid_mjcf(x, y, yaw, opening)
        return BenchTask(name, placement, text, 0.0, 0.5 if name.endswith("open") else -0.5)
    if name.startswith("faucet"):
        return BenchTask(name, placement, faucet_mjcf(x, y, yaw), 0.0, 0.5 if name.endswith("left") else -0.5)
    shape = DoorShape(x=float(rng.uniform(0.56, 0.64)), y=y, yaw=yaw, ajar=float(rng.uniform(0.1, 0.2)))
    start, way = (0.0, 0.5) if name.endswith("open") else (0.5, -0.45)
    return BenchTask(name, placement, door_mjcf(shape), start, start + way)
