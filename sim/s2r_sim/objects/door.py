"""A procedural cabinet with a hinged door (upright axis): cupboards, microwaves, safes.

Object frame: origin on the table below the middle of the carcass's front plane, x out of the cabinet, z up.
The joint coordinate is the opening angle, 0 when closed.
"""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np

from s2r_sim.objects.parameters import Rgb, Standing, tinted, uniform
from s2r_sim.objects.solids import Finish, box, hinge, rod, share_mass, stand


class DoorSpec(Standing):
    """One cabinet with a door.

    Attributes:
        width_m, height_m, depth_m, wall_m: Of the carcass.
        panel_m: Width of a fixed panel beside the door (a microwave's keys), 0 for none.
        left: The hinge is on the object's left (+y) side.
        door_m: Thickness of the door.
        inset_m: Axis behind the door's outer face.
        handle: Bar, knob or none, near the free edge.
        handle_size_m, handle_gap_m: Length and free space of the bar; length of a knob is the gap.
        window: A dark window in the door.
        shelf: A shelf inside.
    """

    kind: Literal["door"] = "door"
    width_m: float
    height_m: float
    depth_m: float
    wall_m: float
    panel_m: float
    left: bool
    door_m: float
    inset_m: float
    handle: Literal["bar", "knob", "none"]
    handle_size_m: float
    handle_gap_m: float
    window: bool
    shelf: bool
    door_rgb: Rgb
    body_rgb: Rgb


def draw_door(rng: np.random.Generator) -> DoorSpec:
    """Draw a cabinet in reach, its door ajar to half open."""
    height = uniform(rng, 0.2, 0.5)
    q_max = uniform(rng, np.deg2rad(85), np.deg2rad(150))
    thick = uniform(rng, 0.010, 0.030)
    return DoorSpec(
        x_m=uniform(rng, 0.62, 0.75),
        y_m=uniform(rng, -0.08, 0.08),
        yaw_rad=uniform(rng, -0.3, 0.3),
        q_start=uniform(rng, 0.0, np.deg2rad(50)),
        q_max=q_max,
        coulomb=uniform(rng, 0.05, 0.5),
        damping=uniform(rng, 0.02, 0.3),
        mass_kg=uniform(rng, 0.3, 2.5),
        friction=uniform(rng, 0.3, 0.6),
        width_m=uniform(rng, 0.22, 0.45),
        height_m=height,
        depth_m=uniform(rng, 0.2, 0.4),
        wall_m=uniform(rng, 0.008, 0.018),
        panel_m=uniform(rng, 0.06, 0.10) if rng.uniform() < 0.3 else 0.0,
        left=bool(rng.uniform() < 0.5),
        door_m=thick,
        inset_m=uniform(rng, 0.0, thick),
        handle=("bar", "knob", "none")[int(rng.choice(3, p=[0.5, 0.3, 0.2]))],
        handle_size_m=uniform(rng, 0.06, min(0.2, 0.7 * height)),
        handle_gap_m=uniform(rng, 0.018, 0.040),
        window=bool(rng.uniform() < 0.3),
        shelf=bool(rng.uniform() < 0.5),
        door_rgb=tinted(rng, 0.25, 0.9),
        body_rgb=tinted(rng, 0.25, 0.9),
    )


def add_door(world: mujoco.MjSpec, spec: DoorSpec) -> None:
    """Add carcass and door."""
    base, part = stand(world, spec)
    wood = Finish(spec.body_rgb, spec.friction)
    w, h, d, t = spec.width_m / 2, spec.height_m, spec.depth_m, spec.wall_m
    sign = 1.0 if spec.left else -1.0
    box(base, "base_left", (-d, w - t, 0), (0, w, h), wood)
    box(base, "base_right", (-d, -w, 0), (0, -w + t, h), wood)
    box(base, "base_back", (-d, -w + t, 0), (-d + t, w - t, h), wood)
    box(base, "base_floor", (-d + t, -w + t, 0), (0, w - t, t), wood)
    box(base, "base_top", (-d + t, -w + t, h - t), (0, w - t, h), wood)
    if spec.shelf:
        box(base, "base_shelf", (-d + t, -w + t, 0.5 * h), (-0.02, w - t, 0.5 * h + 0.6 * t), wood)
    free = -sign * (w - spec.panel_m)  # y of the free edge
    if spec.panel_m > 0:
        box(base, "base_panel", (-d + t, free, 0), (spec.door_m, -sign * w, h), wood)
    geoms = _door(part, spec, sign * (w - 0.001), free + sign * 0.002)
    share_mass(geoms, spec.mass_kg)
    # The free edge swings out towards +x.
    hinge(part, spec, (spec.door_m - spec.inset_m, sign * (w - 0.004), 0.0), (0.0, 0.0, sign))


def _door(part: mujoco.MjsBody, spec: DoorSpec, y_hinge: float, y_free: float) -> list[mujoco.MjsGeom]:
    skin, x = Finish(spec.door_rgb, spec.friction), spec.door_m
    low, high = 0.003, spec.height_m - 0.003
    geoms = [box(part, "part_door", (0.001, y_hinge, low), (x, y_free, high), skin)]
    if spec.window:
        dark = Finish((0.12, 0.12, 0.13), spec.friction)
        y0, y1 = np.interp([0.15, 0.8], [0, 1], [y_hinge, y_free])
        z0, z1 = np.interp([0.15, 0.85], [0, 1], [low, high])
        geoms.append(box(part, "part_window", (x, y0, z0), (x + 0.0008, y1, z1), dark))
    metal = Finish((0.62, 0.63, 0.65), spec.friction)
    y = float(np.interp(0.9, [0, 1], [y_hinge, y_free]))
    z, half, gap = spec.height_m / 2, spec.handle_size_m / 2, spec.handle_gap_m
    if spec.handle == "bar":
        geoms.append(
            box(
                part, "part_bar", (x + gap, y - 0.006, z - half), (x + gap + 0.01, y + 0.006, z + half), metal
            )
        )
        for k, zk in enumerate((z - half + 0.006, z + half - 0.006)):
            geoms.append(
                box(
                    part,
                    f"part_post_{k}",
                    (x, y - 0.006, zk - 0.006),
                    (x + gap, y + 0.006, zk + 0.006),
                    metal,
                )
            )
    elif spec.handle == "knob":
        geoms.append(rod(part, "part_knob", (x, y, z), (x + gap, y, z), 0.014, metal))
    return geoms
