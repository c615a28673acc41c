"""A procedural laptop: base on the table, lid on a hinge with friction.

Object frame: origin on the table below the hinge line, x towards the user's side (the arm), z up. The joint
coordinate is the opening angle, 0 when closed.
"""

from __future__ import annotations

import math
from typing import Literal

import mujoco
import numpy as np
from pydantic import Field

from s2r_sim.objects.naming import BASE_BODY, BEND_JOINT, FAR_BODY
from s2r_sim.objects.parameters import Parameters, Rgb, Standing, absent, tinted, uniform
from s2r_sim.objects.solids import Finish, box, hinge, rod, share_mass, stand

G = 9.81


class Bend(Parameters):
    """A lid that gives: two plates, joined by a spring hinge parallel to the lid's own.

    Attributes:
        at: Where, as a share of the lid's depth, from its hinge.
        stiffness_Nm_rad, damping_Nms_rad: Of the spring hinge; it is flat at rest but for what the far plate weighs.
    """

    at: float = Field(ge=0.3, le=0.7)
    stiffness_Nm_rad: float = Field(gt=0.0)
    damping_Nms_rad: float = Field(ge=0.0)


class LaptopSpec(Standing):
    """One laptop.

    Attributes:
        width_m, depth_m: Of base and lid.
        base_m, lid_m: Thickness of base and lid.
        hinge_rise_m: Hinge line above the top of the base.
        setback_m: Base behind the hinge line.
        barrel_m: Radius of the hinge barrels.
        barrels: One long barrel or two short ones.
        bezel_m: Frame around the screen.
        stand_m: Height of a riser below, 0 for none.
        bend: Of the lid; None: it is rigid.
    """

    kind: Literal["laptop"] = "laptop"
    width_m: float
    depth_m: float
    base_m: float
    lid_m: float
    hinge_rise_m: float
    setback_m: float
    barrel_m: float
    barrels: int
    bezel_m: float
    stand_m: float
    case_rgb: Rgb
    screen_rgb: Rgb
    keys_rgb: Rgb
    bend: Bend | None = Field(default=None, exclude_if=absent)


def draw_laptop(rng: np.random.Generator) -> LaptopSpec:
    """Draw a laptop that stands in reach, its lid half open."""
    depth = uniform(rng, 0.19, 0.27)
    mass = uniform(rng, 0.25, 0.9)
    case = tinted(rng, 0.10, 0.85)
    q_max = uniform(rng, np.deg2rad(110), np.deg2rad(180))
    return LaptopSpec(
        x_m=uniform(rng, 0.62, 0.74),
        y_m=uniform(rng, -0.08, 0.08),
        yaw_rad=uniform(rng, -0.4, 0.4),
        q_start=uniform(rng, np.deg2rad(45), min(np.deg2rad(115), q_max - 0.1)),
        q_max=q_max,
        coulomb=round(mass * G * depth / 2 * uniform(rng, 1.15, 2.2), 6),  # the lid stays where it is put
        damping=uniform(rng, 0.02, 0.2),
        mass_kg=mass,
        friction=uniform(rng, 0.3, 0.6),
        width_m=round(depth * uniform(rng, 1.3, 1.55), 6),
        depth_m=depth,
        base_m=uniform(rng, 0.010, 0.026),
        lid_m=uniform(rng, 0.004, 0.010),
        hinge_rise_m=uniform(rng, -0.003, 0.006),
        setback_m=uniform(rng, 0.0, 0.018),
        barrel_m=uniform(rng, 0.003, 0.006),
        barrels=int(rng.integers(1, 3)),
        bezel_m=uniform(rng, 0.004, 0.018),
        stand_m=uniform(rng, 0.02, 0.10) if rng.uniform() < 0.2 else 0.0,
        case_rgb=case,
        screen_rgb=tinted(rng, 0.08, 0.3),
        keys_rgb=tinted(rng, 0.08, 0.5),
    )


def draw_bend(
    rng: np.random.Generator, spec: LaptopSpec, stiffness_Nm_rad: tuple[float, float] = (12.0, 45.0)
) -> Bend:
    """Draw how a thin lid gives: 0.6 to 4° under 5 N at its far edge, rung down to a third within a third of a second.

    Chosen by what hands feel; no lid was measured.
    """
    at, stiffness, damping_ratio = (
        uniform(rng, 0.33, 0.5),
        uniform(rng, *stiffness_Nm_rad),
        uniform(rng, 0.07, 0.2),
    )
    far = 1.0 - at
    inertia = spec.mass_kg * far * (far * spec.depth_m) ** 2 / 3
    damping = round(2.0 * damping_ratio * math.sqrt(stiffness * inertia), 6)
    return Bend(at=at, stiffness_Nm_rad=stiffness, damping_Nms_rad=damping)


def add_laptop(world: mujoco.MjSpec, spec: LaptopSpec) -> None:
    """Add base and lid."""
    base, part = stand(world, spec)
    case = Finish(spec.case_rgb, spec.friction)
    w, d, z = spec.width_m / 2, spec.depth_m, spec.stand_m
    top = z + spec.base_m
    if z > 0:
        box(base, "base_stand", (0.02, -w + 0.03, 0), (d - 0.03, w - 0.03, z), Finish((0.5, 0.5, 0.52), 0.5))
    box(base, "base_case", (-spec.setback_m, -w, z), (d, w, top), case)
    box(
        base,
        "base_keys",
        (0.02, -0.9 * w, top),
        (0.55 * d, 0.9 * w, top + 0.0012),
        Finish(spec.keys_rgb, spec.friction),
    )
    pad = Finish(spec.keys_rgb, spec.friction)
    box(base, "base_pad", (0.62 * d, -0.3 * w, top), (0.93 * d, 0.3 * w, top + 0.0004), pad)
    height = top + spec.hinge_rise_m
    share_mass(_lid(world, part, spec, height), spec.mass_kg)
    ends = ((-0.4 * w, 0.4 * w),) if spec.barrels == 1 else ((-0.85 * w, -0.6 * w), (0.6 * w, 0.85 * w))
    for k, (y0, y1) in enumerate(ends):
        rod(base, f"base_barrel_{k}", (0, y0, height), (0, y1, height), spec.barrel_m, case)
    hinge(part, spec, (0.0, 0.0, height), (0.0, -1.0, 0.0))


def _lid(world: mujoco.MjSpec, part: mujoco.MjsBody, spec: LaptopSpec, z: float) -> list[mujoco.MjsGeom]:
    """The closed lid, lying on the base with its hinge line at height ``z``; its screen looks down."""
    names, bend = ("part_lid", "part_screen"), spec.bend
    if bend is None:
        return _plate(part, spec, z, names, 0.002, spec.depth_m)
    x = bend.at * spec.depth_m
    near = _plate(part, spec, z, names, 0.002, x)
    far = part.add_body(name=FAR_BODY)
    world.add_exclude(bodyname1=BASE_BODY, bodyname2=FAR_BODY)
    far.add_joint(
        name=BEND_JOINT,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        pos=[x, 0.0, z + 0.001 + spec.lid_m / 2],
        axis=[0.0, -1.0, 0.0],
        stiffness=[bend.stiffness_Nm_rad, 0, 0],
        damping=[bend.damping_Nms_rad, 0, 0],
    )
    return near + _plate(far, spec, z, ("part_lid_far", "part_screen_far"), x, spec.depth_m)


def _plate(
    body: mujoco.MjsBody, spec: LaptopSpec, z: float, names: tuple[str, str], x0: float, x1: float
) -> list[mujoco.MjsGeom]:
    """Shell and screen of the lid from ``x0`` to ``x1`` off the hinge line."""
    w, bezel = spec.width_m / 2, spec.bezel_m
    low, high = max(x0, 0.012 + bezel), min(x1, spec.depth_m - bezel)
    case, screen = Finish(spec.case_rgb, spec.friction), Finish(spec.screen_rgb, spec.friction)
    return [
        box(body, names[0], (x0, -w, z + 0.001), (x1, w, z + 0.001 + spec.lid_m), case),
        box(body, names[1], (low, -w + bezel, z + 0.0002), (high, w - bezel, z + 0.001), screen),
    ]
