"""A procedural faucet on a deck: body, spout and a handle that turns (lever on top, lever at the side, or a
pair).

Object frame: origin on the table below the body, x towards the arm (the user), z up. The joint coordinate is
the angle of the handle, 0 at one stop.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import mujoco
import numpy as np
from pydantic import Field

from s2r_sim.objects.parameters import Rgb, Standing, tinted, uniform
from s2r_sim.objects.solids import Finish, bar, box, hinge, rod, share_mass, stand

STYLES = ("top", "side", "pair")


class FaucetSpec(Standing):
    """One faucet.

    Attributes:
        style: Lever on top of the body (axis upright), at its side (axis level), or one of two handles on the deck.
        deck_m: Size of the deck plate or block (x, y, z).
        body_radius_m, body_height_m: Of the body above the deck.
        spout_reach_m, spout_rise_m, spout_radius_m: How far and how high the spout goes.
        spout_yaw_rad: Where it points.
        hub_radius_m, hub_height_m: Of the handle's round foot.
        lever_m: Length of the handle from its axis.
        lever_width_m, lever_thick_m: Cross-section.
        lever_rise_rad: Lever above (top, pair) the plane of turning.
        lever_yaw_rad: Where the lever points half-way between its stops; 0 is towards the arm.
        round_lever: A rod instead of a flat bar.
        spokes: 1 for a lever, 2 to 4 for a cross handle (pair only).
        tilt_rad: Of the upright axis towards the user.
    """

    kind: Literal["faucet"] = "faucet"
    style: Literal["top", "side", "pair"]
    deck_m: tuple[float, float, float]
    body_radius_m: float
    body_height_m: float
    spout_reach_m: float
    spout_rise_m: float
    spout_radius_m: float
    spout_yaw_rad: float
    hub_radius_m: float
    hub_height_m: float
    lever_m: float
    lever_width_m: float
    lever_thick_m: float
    lever_rise_rad: float
    lever_yaw_rad: float
    round_lever: bool
    spokes: int = Field(ge=1)
    tilt_rad: float
    metal_rgb: Rgb
    deck_rgb: Rgb


def draw_faucet(rng: np.random.Generator) -> FaucetSpec:
    """Draw a faucet that stands in reach, its handle somewhere between the stops."""
    style = STYLES[int(rng.choice(3, p=[0.45, 0.3, 0.25]))]
    q_max = uniform(rng, np.deg2rad(70), np.deg2rad(180) if style == "pair" else np.deg2rad(120))
    tall = style != "pair"
    block = rng.uniform() < 0.3
    deck = (
        uniform(rng, 0.06, 0.2),
        uniform(rng, 0.24, 0.36) if style == "pair" else uniform(rng, 0.06, 0.25),
        uniform(rng, 0.04, 0.12) if block else uniform(rng, 0.003, 0.02),
    )
    width = uniform(rng, 0.012, 0.034)
    spokes = int(rng.integers(2, 5)) if style == "pair" and rng.uniform() < 0.3 else 1
    return FaucetSpec(
        x_m=uniform(rng, 0.52, 0.66),
        y_m=uniform(rng, -0.08, 0.08),
        yaw_rad=uniform(rng, -0.5, 0.5),
        q_start=round(q_max * uniform(rng, 0.1, 0.9), 6),
        q_max=q_max,
        coulomb=uniform(rng, 0.15, 0.6),
        damping=uniform(rng, 0.01, 0.1),
        mass_kg=uniform(rng, 0.08, 0.35),
        friction=uniform(rng, 0.2, 0.5),
        style=style,
        deck_m=deck,
        body_radius_m=uniform(rng, 0.015, 0.030),
        body_height_m=uniform(rng, 0.07, 0.22) if tall else uniform(rng, 0.04, 0.10),
        spout_reach_m=uniform(rng, 0.08, 0.2),
        spout_rise_m=uniform(rng, 0.0, 0.12),
        spout_radius_m=uniform(rng, 0.008, 0.014),
        spout_yaw_rad=uniform(rng, -0.3, 0.3),
        hub_radius_m=uniform(rng, 0.012, 0.026),
        hub_height_m=uniform(rng, 0.015, 0.04),
        lever_m=uniform(rng, 0.07, 0.17) if spokes == 1 else uniform(rng, 0.03, 0.05),
        lever_width_m=width,
        lever_thick_m=round(min(width, uniform(rng, 0.008, 0.018)), 6),
        lever_rise_rad=uniform(rng, 0.0, np.deg2rad(40)),
        lever_yaw_rad=uniform(rng, -np.pi / 2, np.pi / 2)
        if rng.uniform() < 0.7
        else uniform(rng, -np.pi, np.pi),
        round_lever=bool(rng.uniform() < 0.35),
        spokes=spokes,
        tilt_rad=uniform(rng, 0.0, 0.25) if style == "top" and rng.uniform() < 0.4 else 0.0,
        metal_rgb=tinted(rng, 0.35, 0.85),
        deck_rgb=tinted(rng, 0.5, 0.9),
    )


def add_faucet(world: mujoco.MjSpec, spec: FaucetSpec) -> None:
    """Add deck, body, spout and handles."""
    base, part = stand(world, spec)
    metal = Finish(spec.metal_rgb, spec.friction)
    dx, dy, dz = spec.deck_m
    box(base, "base_deck", (-dx / 2, -dy / 2, 0), (dx / 2, dy / 2, dz), Finish(spec.deck_rgb, 0.5))
    foot, top = np.array([0.0, 0.0, dz]), np.array([0.0, 0.0, dz + spec.body_height_m])
    rod(base, "base_column", foot, top, spec.body_radius_m, metal)
    _add_spout(base, spec, top, metal)
    if spec.style == "side":
        _add_side_lever(part, spec, top, metal)
    elif spec.style == "top":
        up = np.array([np.sin(spec.tilt_rad), 0.0, np.cos(spec.tilt_rad)])
        _add_handle(part, "part", spec, top, up, spec.lever_yaw_rad - spec.q_max / 2, metal)
        hinge(part, spec, top, up)
    else:
        up, side = np.array([0.0, 0.0, 1.0]), np.array([0.0, dy / 2 - 0.03, dz])
        start = spec.lever_yaw_rad - spec.q_max / 2
        _add_handle(part, "part", spec, side, up, start, metal)
        _add_handle(base, "base_other", spec, side * (1, -1, 1), up, np.pi - start, metal)
        hinge(part, spec, side, up)


def _add_spout(base: mujoco.MjsBody, spec: FaucetSpec, top: np.ndarray, metal: Finish) -> None:
    """An arc of four capsules from below the top of the body forward, its end bent down."""
    forward = np.array([np.cos(spec.spout_yaw_rad), np.sin(spec.spout_yaw_rad), 0.0])
    low = top - (0.0, 0.0, 0.3 * spec.body_height_m)
    shape = ((0.0, 0.0), (0.3, 0.8), (0.7, 1.0), (0.95, 0.7), (1.0, 0.35))
    points = [low + a * spec.spout_reach_m * forward + (0, 0, b * spec.spout_rise_m) for a, b in shape]
    points[-1] = points[-1] - (0.0, 0.0, 0.015)
    for k, (a, b) in enumerate(pairwise(points)):
        rod(base, f"base_spout_{k}", a, b, spec.spout_radius_m, metal, round_ends=True)


def _add_handle(
    body: mujoco.MjsBody,
    name: str,
    spec: FaucetSpec,
    foot: np.ndarray,
    up: np.ndarray,
    yaw: float,
    metal: Finish,
) -> None:
    """Hub and lever (or spokes) about an upright axis; ``yaw`` is where the first spoke points."""
    head = foot + spec.hub_height_m * up
    geoms = [rod(body, f"{name}_hub", foot + 0.0005 * up, head, spec.hub_radius_m, metal)]
    e1 = np.cross([0.0, 1.0, 0.0], up)
    e2 = np.cross(up, e1)
    root = head - 0.5 * spec.lever_thick_m * up
    rise = spec.lever_rise_rad if spec.spokes == 1 else 0.0
    for k in range(spec.spokes):
        angle = yaw + 2 * np.pi * k / spec.spokes
        out = np.cos(rise) * (np.cos(angle) * e1 + np.sin(angle) * e2) + np.sin(rise) * up
        geoms.append(_lever(body, f"{name}_lever_{k}", spec, root, root + spec.lever_m * out, metal))
    share_mass(geoms, spec.mass_kg)


def _add_side_lever(part: mujoco.MjsBody, spec: FaucetSpec, top: np.ndarray, metal: Finish) -> None:
    """A hub at the left of the body, its axis level; at 0 the lever leans back, then it swings to the front."""
    side = np.array([0.0, 1.0, 0.0])
    foot = top - (0.0, 0.0, 0.25 * spec.body_height_m) + spec.body_radius_m * side
    head = foot + spec.hub_height_m * side
    geoms = [rod(part, "part_hub", foot, head, spec.hub_radius_m, metal)]
    root = head - 0.5 * spec.lever_thick_m * side
    lean = np.deg2rad(35) - spec.q_max / 2
    out = np.array([np.sin(lean), 0.3 * np.sin(spec.lever_rise_rad), np.cos(lean)])
    geoms.append(
        _lever(part, "part_lever_0", spec, root, root + spec.lever_m * out / np.linalg.norm(out), metal)
    )
    share_mass(geoms, spec.mass_kg)
    hinge(part, spec, foot, side)


def _lever(
    body: mujoco.MjsBody, name: str, spec: FaucetSpec, a: np.ndarray, b: np.ndarray, metal: Finish
) -> mujoco.MjsGeom:
    if spec.round_lever:
        return rod(body, name, a, b, spec.lever_width_m / 2, metal, round_ends=True)
    return bar(body, name, a, b, spec.lever_width_m, spec.lever_thick_m, metal)
