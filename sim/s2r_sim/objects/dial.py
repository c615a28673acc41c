"""A procedural panel with dials: stove knobs, timers, valves; one of them turns.

Object frame: origin on the table below the middle of the panel's face, x out of the panel (towards the arm),
z up. The joint coordinate is the dial's angle, 0 at one stop.
"""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
from pydantic import Field, model_validator

from s2r_sim.objects.parameters import Rgb, Standing, tinted, uniform
from s2r_sim.objects.solids import Finish, bar, box, hinge, rod, share_mass, stand


class DialSpec(Standing):
    """One panel with dials.

    Attributes:
        width_m, height_m, depth_m: Of the housing.
        lean_rad: The face looks this much upwards.
        dials, index: Number of dials in a row and which one turns.
        radius_m, length_m: Of every dial's round foot.
        wing_m: Length of its wing from the axis (the part a finger pushes).
        wing_width_m, wing_height_m: Cross-section of the wing.
    """

    kind: Literal["dial"] = "dial"
    width_m: float
    height_m: float
    depth_m: float
    lean_rad: float
    dials: int = Field(ge=1)
    index: int = Field(ge=0)
    radius_m: float
    length_m: float
    wing_m: float
    wing_width_m: float
    wing_height_m: float
    panel_rgb: Rgb
    dial_rgb: Rgb

    @model_validator(mode="after")
    def _one_turns(self) -> DialSpec:
        if self.index >= self.dials:
            raise ValueError(f"index {self.index} is none of {self.dials} dials; they count from 0")
        return self


def draw_dial(rng: np.random.Generator) -> DialSpec:
    """Draw a panel in reach."""
    radius = uniform(rng, 0.014, 0.03)
    wing = round(radius * uniform(rng, 1.0, 2.2), 6)
    dials = int(rng.integers(1, 4))
    q_max = uniform(rng, np.deg2rad(90), np.deg2rad(270))
    return DialSpec(
        x_m=uniform(rng, 0.54, 0.66),
        y_m=uniform(rng, -0.08, 0.08),
        yaw_rad=uniform(rng, -0.3, 0.3),
        q_start=round(q_max * uniform(rng, 0.1, 0.9), 6),
        q_max=q_max,
        coulomb=uniform(rng, 0.02, 0.15),
        damping=uniform(rng, 0.002, 0.02),
        mass_kg=uniform(rng, 0.03, 0.15),
        friction=uniform(rng, 0.3, 0.6),
        width_m=round(dials * (2 * wing + 0.03) + uniform(rng, 0.02, 0.15), 6),
        height_m=round(2 * wing + uniform(rng, 0.04, 0.15), 6),
        depth_m=uniform(rng, 0.08, 0.25),
        lean_rad=uniform(rng, 0.0, np.deg2rad(60)),
        dials=dials,
        index=int(rng.integers(dials)),
        radius_m=radius,
        length_m=uniform(rng, 0.010, 0.025),
        wing_m=wing,
        wing_width_m=uniform(rng, 0.006, 0.014),
        wing_height_m=uniform(rng, 0.010, 0.025),
        panel_rgb=tinted(rng, 0.3, 0.9),
        dial_rgb=tinted(rng, 0.2, 0.8),
    )


def add_dial(world: mujoco.MjSpec, spec: DialSpec) -> None:
    """Add housing and dials."""
    base, part = stand(world, spec)
    out = np.array([np.cos(spec.lean_rad), 0.0, np.sin(spec.lean_rad)])
    up = np.array([-np.sin(spec.lean_rad), 0.0, np.cos(spec.lean_rad)])
    # The housing is a slab behind its face, lifted until its lowest corner stands on the table.
    half = np.array([spec.depth_m, spec.width_m, spec.height_m]) / 2
    lift = half[2] * np.cos(spec.lean_rad) + max(2 * half[0] * np.sin(spec.lean_rad), 0.0)
    face = np.array([0.0, 0.0, lift])
    quat = (np.cos(spec.lean_rad / 2), 0.0, -np.sin(spec.lean_rad / 2), 0.0)
    middle = face - half[0] * out
    panel = Finish(spec.panel_rgb, spec.friction)
    box(base, "base_housing", middle - half, middle + half, panel, quat)
    pitch = spec.width_m / spec.dials
    for k in range(spec.dials):
        moves = k == spec.index
        body, name = (part, "part") if moves else (base, f"base_dial_{k}")
        p = face + ((k + 0.5) * pitch - spec.width_m / 2) * np.array([0.0, 1.0, 0.0])
        _add_one(body, name, spec, p, out, up, moves)


def _add_one(
    body: mujoco.MjsBody,
    name: str,
    spec: DialSpec,
    p: np.ndarray,
    out: np.ndarray,
    up: np.ndarray,
    moves: bool,
) -> None:
    finish = Finish(spec.dial_rgb, spec.friction)
    foot, head = p + 0.001 * out, p + (0.001 + spec.length_m) * out
    ridge = head + 0.5 * spec.wing_height_m * out
    geoms = [
        rod(body, f"{name}_foot", foot, head, spec.radius_m, finish),
        bar(
            body, f"{name}_wing", ridge - 0.4 * spec.wing_m * up, ridge + spec.wing_m * up,
            spec.wing_width_m, spec.wing_height_m, finish,
        ),
    ]  # fmt: skip
    if moves:
        share_mass(geoms, spec.mass_kg)
        hinge(body, spec, p, out)
