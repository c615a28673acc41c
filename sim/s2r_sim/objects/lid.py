"""A procedural box with a hinged lid (level axis at the back): chests, bins, tool boxes.

Object frame: origin on the table below the hinge line, x towards the arm, z up. The joint coordinate is the
opening angle, 0 when closed.
"""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np

from s2r_sim.objects.parameters import Rgb, Standing, tinted, uniform
from s2r_sim.objects.solids import Finish, box, hinge, share_mass, stand

G = 9.81


class LidSpec(Standing):
    """One box with a lid.

    Attributes:
        width_m, height_m, depth_m, wall_m: Of the box.
        lid_m: Thickness of the lid.
        rim_m: Height of the lid's rim, 0 for a flat lid.
        lip_m: How far the lid stands out at the front.
    """

    kind: Literal["lid"] = "lid"
    width_m: float
    height_m: float
    depth_m: float
    wall_m: float
    lid_m: float
    rim_m: float
    lip_m: float
    lid_rgb: Rgb
    body_rgb: Rgb


def draw_lid(rng: np.random.Generator) -> LidSpec:
    """Draw a box in reach, its lid half open."""
    depth, mass = uniform(rng, 0.15, 0.32), uniform(rng, 0.2, 1.2)
    q_max = uniform(rng, np.deg2rad(75), np.deg2rad(115))
    return LidSpec(
        x_m=uniform(rng, 0.66, 0.76),
        y_m=uniform(rng, -0.08, 0.08),
        yaw_rad=uniform(rng, -0.4, 0.4),
        q_start=uniform(rng, np.deg2rad(15), q_max - 0.15),
        q_max=q_max,
        coulomb=round(mass * G * depth / 2 * uniform(rng, 1.15, 2.0), 6),  # a stay holds the lid
        damping=uniform(rng, 0.02, 0.3),
        mass_kg=mass,
        friction=uniform(rng, 0.3, 0.6),
        width_m=uniform(rng, 0.18, 0.42),
        height_m=uniform(rng, 0.08, 0.28),
        depth_m=depth,
        wall_m=uniform(rng, 0.004, 0.014),
        lid_m=uniform(rng, 0.005, 0.02),
        rim_m=uniform(rng, 0.01, 0.04) if rng.uniform() < 0.4 else 0.0,
        lip_m=uniform(rng, 0.0, 0.02),
        lid_rgb=tinted(rng, 0.25, 0.9),
        body_rgb=tinted(rng, 0.25, 0.9),
    )


def add_lid(world: mujoco.MjSpec, spec: LidSpec) -> None:
    """Add box and lid."""
    base, part = stand(world, spec)
    body = Finish(spec.body_rgb, spec.friction)
    w, h, d, t = spec.width_m / 2, spec.height_m, spec.depth_m, spec.wall_m
    box(base, "base_floor", (0, -w, 0), (d, w, t), body)
    box(base, "base_back", (0, -w, t), (t, w, h), body)
    box(base, "base_front", (d - t, -w, t), (d, w, h), body)
    box(base, "base_left", (t, w - t, t), (d - t, w, h), body)
    box(base, "base_right", (t, -w, t), (d - t, -w + t, h), body)
    skin = Finish(spec.lid_rgb, spec.friction)
    z, front = h + spec.rim_m + 0.001, d + spec.lip_m
    geoms = [box(part, "part_lid", (0, -w, z), (front, w, z + spec.lid_m), skin)]
    if spec.rim_m > 0:
        low = h + 0.001
        geoms += [
            box(part, "part_rim_front", (front - t, -w, low), (front, w, z), skin),
            box(part, "part_rim_left", (0.01, w - t, low), (front - t, w, z), skin),
            box(part, "part_rim_right", (0.01, -w, low), (front - t, -w + t, z), skin),
        ]
    share_mass(geoms, spec.mass_kg)
    hinge(part, spec, (0.0, 0.0, h), (0.0, -1.0, 0.0))
