"""A procedural drawer: cabinet on the table, one drawer with a bar handle, hidden rail friction and play.

Object frame: origin on the table below the middle of the cabinet's front plane, x out of the cabinet (towards
the arm), z up. The joint coordinate is 0 when closed and positive outwards.
"""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
from pydantic import Field, model_validator

from s2r_sim.objects.naming import BASE_BODY, JOINT, PART_BODY
from s2r_sim.objects.parameters import Parameters, absent, uniform
from s2r_sim.objects.solids import HARD, STIFF

WALL_M = 0.012
SIDE_CLEARANCE_M = 0.012  # rail space on each side
BOTTOM_CLEARANCE_M = 0.012
PLAY_STIFFNESS = 4000.0  # N/m: 4 N of side load move the drawer 1 mm in its rail
PLAY_STIFFNESS_ROT = 60.0  # N·m/rad
RUNNER_M = 0.1  # lever of the friction on runners 0.2 m long


class Slop(Parameters):
    """Free clearance of a rail: within it nothing leads the drawer back, it only rubs; beyond it is a stiff stop.

    The drawer pitches about the rail's end at the cabinet's front, so that it leans on one stop or the other by its own
    weight, as it is further in or out.

    Attributes:
        sideways_m, yaw_rad, pitch_rad: Half of it.
        friction_N, friction_Nm: What the drawer rubs with sideways, and about both axes.
    """

    sideways_m: float = Field(gt=0.0)
    yaw_rad: float = Field(gt=0.0)
    pitch_rad: float = Field(gt=0.0)
    friction_N: float = Field(ge=0.0)
    friction_Nm: float = Field(ge=0.0)


class DrawerSpec(Parameters):
    """Hidden parameters of one drawer.

    Attributes:
        x_front_m, y_m, yaw_rad: Object frame in the arm base frame; at yaw 0 the front faces the arm.
        width_m, height_m, depth_m: Cabinet, outside.
        front_height_m, front_thickness_m: Drawer front; it covers the cabinet's width and ends at its top.
        handle_gap_m: Free space between front and bar.
        handle_bar_m: Side of the square bar.
        handle_width_m: Length of the bar.
        handle_drop_m: From the top edge of the front down to the bar's centre line.
        mass_kg: All that slides.
        coulomb_N, damping_Ns_m: Rail friction.
        axis_tilt_rad: Pitch and yaw of the rail away from the front's normal.
        play_m, play_rad: Half play of the rail, sideways and about the vertical; springs lead back to its middle.
        slop: Free clearance that takes the place of that play; None: there is none.
        range_m: Largest opening.
        opening_m: Opening at the start.
        friction: Sliding friction of the visible surfaces.
        front_rgb, body_rgb, handle_rgb: Colours, 0..1.
    """

    kind: Literal["drawer"] = "drawer"
    x_front_m: float
    y_m: float
    yaw_rad: float
    width_m: float
    height_m: float
    depth_m: float
    front_height_m: float
    front_thickness_m: float
    handle_gap_m: float
    handle_bar_m: float
    handle_width_m: float
    handle_drop_m: float
    mass_kg: float = Field(gt=0.0)
    coulomb_N: float = Field(ge=0.0)
    damping_Ns_m: float = Field(ge=0.0)
    axis_tilt_rad: tuple[float, float]
    play_m: float = Field(gt=0.0)
    play_rad: float = Field(gt=0.0)
    range_m: float = Field(gt=0.0)
    opening_m: float = Field(ge=0.0)
    friction: float = Field(ge=0.0)
    front_rgb: tuple[float, float, float]
    body_rgb: tuple[float, float, float]
    handle_rgb: tuple[float, float, float]
    slop: Slop | None = Field(default=None, exclude_if=absent)

    @model_validator(mode="after")
    def _found_between_its_stops(self) -> DrawerSpec:
        if self.opening_m > self.range_m:
            raise ValueError(f"opening_m {self.opening_m:g} is beyond range_m {self.range_m:g}")
        return self

    @property
    def q_start(self) -> float:
        """Joint value as found [m]."""
        return self.opening_m

    @property
    def q_max(self) -> float:
        """Upper stop [m]."""
        return self.range_m


def draw_drawer(rng: np.random.Generator) -> DrawerSpec:
    """Draw the hidden parameters of a drawer that stands in reach."""
    opening = uniform(rng, 0.05, 0.10)
    x_face = uniform(rng, 0.56, 0.65)  # outer face of the front as found
    thickness = uniform(rng, 0.014, 0.022)
    height = uniform(rng, 0.20, 0.29)
    range_m = uniform(rng, 0.30, 0.38)
    width = uniform(rng, 0.28, 0.40)
    shade = uniform(rng, 0.55, 0.85)
    return DrawerSpec(
        x_front_m=round(x_face + thickness + opening, 6),
        y_m=uniform(rng, -0.06, 0.06),
        yaw_rad=uniform(rng, -np.deg2rad(10), np.deg2rad(10)),
        width_m=width,
        height_m=height,
        depth_m=round(range_m + uniform(rng, 0.06, 0.10), 6),
        front_height_m=uniform(rng, 0.12, min(0.18, height - 0.03)),
        front_thickness_m=thickness,
        handle_gap_m=uniform(rng, 0.032, 0.045),
        handle_bar_m=uniform(rng, 0.008, 0.014),
        handle_width_m=uniform(rng, 0.08, 0.16),
        handle_drop_m=uniform(rng, 0.035, 0.060),
        mass_kg=uniform(rng, 0.8, 4.0),
        coulomb_N=uniform(rng, 1.0, 6.0),
        damping_Ns_m=uniform(rng, 2.0, 20.0),
        axis_tilt_rad=(
            uniform(rng, -np.deg2rad(1), np.deg2rad(1)),
            uniform(rng, -np.deg2rad(1), np.deg2rad(1)),
        ),
        play_m=uniform(rng, 0.0002, 0.001),
        play_rad=uniform(rng, np.deg2rad(0.05), np.deg2rad(0.3)),
        range_m=range_m,
        opening_m=opening,
        friction=uniform(rng, 0.3, 0.6),
        front_rgb=(shade, round(0.85 * shade, 6), round(0.66 * shade, 6)),
        body_rgb=(round(0.80 * shade, 6), round(0.70 * shade, 6), round(0.55 * shade, 6)),
        handle_rgb=(0.62, 0.63, 0.65),
    )


def draw_slop(rng: np.random.Generator) -> Slop:
    """Draw a worn rail: 0.6 to 3 mm and 0.2 to 1.2° from stop to stop. Chosen; no drawer was measured."""
    friction = uniform(rng, 0.2, 1.0)
    return Slop(
        sideways_m=uniform(rng, 0.0003, 0.0015),
        yaw_rad=uniform(rng, np.deg2rad(0.1), np.deg2rad(0.6)),
        pitch_rad=uniform(rng, np.deg2rad(0.05), np.deg2rad(0.3)),
        friction_N=friction,
        friction_Nm=round(friction * RUNNER_M, 6),
    )


def add_drawer(world: mujoco.MjSpec, spec: DrawerSpec) -> None:
    """Add cabinet and drawer to a world.

    Bodies ``object_base`` and ``object_part``, joint ``object_joint``, geoms ``base_*`` and ``part_*``.
    """
    half_turn = np.pi + spec.yaw_rad  # object x looks at the arm
    base = world.worldbody.add_body(
        name=BASE_BODY,
        pos=[spec.x_front_m, spec.y_m, 0.0],
        quat=[np.cos(half_turn / 2), 0.0, 0.0, np.sin(half_turn / 2)],
    )
    _add_cabinet(base, spec)
    part = base.add_body(name=PART_BODY)
    _add_rail(part, spec)
    _add_part_shapes(part, spec)
    world.add_exclude(bodyname1=BASE_BODY, bodyname2=PART_BODY)  # the rails guide it, not the walls


def _box(
    body: mujoco.MjsBody,
    name: str,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    rgb: tuple[float, float, float],
    friction: float,
) -> mujoco.MjsGeom:
    corner, opposite = np.array(low), np.array(high)
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(corner + opposite) / 2,
        size=(opposite - corner) / 2,
        rgba=[*rgb, 1.0],
        friction=[friction, 0.005, 0.0001],
    )


def _add_cabinet(base: mujoco.MjsBody, spec: DrawerSpec) -> None:
    w, h, d, t = spec.width_m / 2, spec.height_m, spec.depth_m, WALL_M
    z_opening = h - spec.front_height_m
    rgb, mu = spec.body_rgb, spec.friction
    _box(base, "base_left", (-d, w - t, 0.0), (0.0, w, h), rgb, mu)
    _box(base, "base_right", (-d, -w, 0.0), (0.0, -w + t, h), rgb, mu)
    _box(base, "base_back", (-d, -w + t, 0.0), (-d + t, w - t, h), rgb, mu)
    _box(base, "base_top", (-d + t, -w + t, h - t), (0.0, w - t, h), rgb, mu)
    _box(base, "base_shelf", (-d + t, -w + t, z_opening - t), (0.0, w - t, z_opening), rgb, mu)
    if z_opening > 2 * t:
        _box(base, "base_panel", (-t, -w + t, 0.0), (0.0, w - t, z_opening - t), rgb, mu)


def _add_rail(part: mujoco.MjsBody, spec: DrawerSpec) -> None:
    """Play or slop first, then the slide: the play carries the rail with it."""
    if spec.slop is None:
        _add_play(part, spec)
    else:
        _add_slop(part, spec.slop, spec.height_m - spec.front_height_m / 2)
    pitch, yaw = spec.axis_tilt_rad
    part.add_joint(
        name=JOINT,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)],
        range=[0.0, spec.range_m],
        limited=True,
        damping=[spec.damping_Ns_m, 0, 0],
        frictionloss=spec.coulomb_N,
        armature=0.02,
        solref_friction=STIFF,  # below Coulomb friction the drawer must not creep
        solimp_friction=HARD,
    )


def _add_play(part: mujoco.MjsBody, spec: DrawerSpec) -> None:
    part.add_joint(
        name="object_play_y",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, 1, 0],
        range=[-spec.play_m, spec.play_m],
        limited=True,
        stiffness=[PLAY_STIFFNESS, 0, 0],
        damping=[40.0, 0, 0],
        armature=0.05,
        solref_limit=STIFF,
    )
    part.add_joint(
        name="object_play_yaw",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        range=[-spec.play_rad, spec.play_rad],
        limited=True,
        stiffness=[PLAY_STIFFNESS_ROT, 0, 0],
        damping=[1.0, 0, 0],
        armature=0.01,
        solref_limit=STIFF,
    )


def _add_slop(part: mujoco.MjsBody, slop: Slop, height_m: float) -> None:
    slide, turn = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, kind, axis, half, friction, armature in (
        ("object_play_y", slide, [0, 1, 0], slop.sideways_m, slop.friction_N, 0.05),
        ("object_play_yaw", turn, [0, 0, 1], slop.yaw_rad, slop.friction_Nm, 0.01),
        ("object_play_pitch", turn, [0, 1, 0], slop.pitch_rad, slop.friction_Nm, 0.01),
    ):
        part.add_joint(
            name=name,
            type=kind,
            pos=[0.0, 0.0, height_m],
            axis=axis,
            range=[-half, half],
            limited=True,
            frictionloss=friction,
            armature=armature,
            solref_limit=STIFF,
            solref_friction=STIFF,
            solimp_friction=HARD,
        )


def _add_part_shapes(part: mujoco.MjsBody, spec: DrawerSpec) -> None:
    t = WALL_M
    z_top, z_low = spec.height_m, spec.height_m - spec.front_height_m
    w_front, x_front = spec.width_m / 2 - 0.002, spec.front_thickness_m
    w_box = spec.width_m / 2 - t - SIDE_CLEARANCE_M
    d_box = spec.depth_m - 2 * t - 0.01
    z0, z1 = z_low + BOTTOM_CLEARANCE_M, z_top - 2 * t
    mu, inside = spec.friction, spec.body_rgb
    wood = [
        _box(
            part, "part_front", (0.0, -w_front, z_low + 0.002), (x_front, w_front, z_top), spec.front_rgb, mu
        ),
        _box(part, "part_floor", (-d_box, -w_box, z0), (0.0, w_box, z0 + t / 2), inside, mu),
        _box(part, "part_left", (-d_box, w_box - t / 2, z0 + t / 2), (0.0, w_box, z1), inside, mu),
        _box(part, "part_right", (-d_box, -w_box, z0 + t / 2), (0.0, -w_box + t / 2, z1), inside, mu),
        _box(
            part,
            "part_rear",
            (-d_box, -w_box + t / 2, z0 + t / 2),
            (-d_box + t / 2, w_box - t / 2, z1),
            inside,
            mu,
        ),
    ]
    volumes = np.array([8 * np.prod(g.size[:3]) for g in wood])
    for geom, share in zip(wood, volumes / volumes.sum(), strict=True):
        geom.mass = spec.mass_kg * float(share)
    _add_handle(part, spec, x_front, z_top - spec.handle_drop_m)


def _add_handle(part: mujoco.MjsBody, spec: DrawerSpec, x: float, z: float) -> None:
    b, w, gap = spec.handle_bar_m / 2, spec.handle_width_m / 2, spec.handle_gap_m
    rgb, mu = spec.handle_rgb, spec.friction
    bar = _box(part, "part_handle_bar", (x + gap, -w, z - b), (x + gap + 2 * b, w, z + b), rgb, mu)
    posts = [
        _box(part, "part_handle_post_left", (x, w - 2 * b, z - b), (x + gap, w, z + b), rgb, mu),
        _box(part, "part_handle_post_right", (x, -w, z - b), (x + gap, -w + 2 * b, z + b), rgb, mu),
    ]
    for geom in (bar, *posts):
        geom.mass = 0.0  # included in mass_kg
