"""Random furniture and fittings as MJCF: ten families, everything about them drawn from a seed.

The frame of an object has its x axis out of its front and z up; lengths are in metres, sizes half lengths as in MJCF.
Nothing here knows of a planner: whether an arm can do what is asked is not looked at.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Rng = np.random.Generator
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Fitting:
    """An object: what stays, what moves, how high its frame is above the floor, and a task."""

    fixed: str
    part: Part
    z_m: float
    target: float


@dataclass(frozen=True)
class Part:
    """The body that joint "part" moves about or along its own origin."""

    at: Triple
    slides: bool
    axis: Triple
    ends: tuple[float, float] | None
    start: float
    friction: float
    damping: float
    geoms: str

    @property
    def mjcf(self) -> str:
        """The body where it starts; its dry friction is firm, which a file has to say for MuJoCo to keep it still."""
        shift = tuple(a + self.slides * self.start * b for a, b in zip(self.at, self.axis, strict=True))
        turned = "" if self.slides else f' axisangle="{numbers(self.axis)} {self.start:.4f}"'
        limits = 'limited="false"' if self.ends is None else f'range="{numbers(self.ends)}"'
        return (
            f'<body name="part" pos="{numbers(shift)}"{turned}><joint name="part" '
            f'type="{"slide" if self.slides else "hinge"}" axis="{numbers(self.axis)}" ref="{self.start:.4f}" {limits} '
            f'damping="{self.damping:.3f}" frictionloss="{self.friction:.3f}" solreffriction="-1e4 -200"/>'
            f"{self.geoms}</body>"
        )


def drawer(rng: Rng) -> Fitting:
    """A drawer in a case, with a bar, a knob or a ring, a little open or shut."""
    wide, high, deep, wall = *uniform(rng, (0.12, 0.22), (0.04, 0.09), (0.14, 0.22)), 0.008
    travel, gap = 1.4 * deep, rng.uniform(0.002, 0.006)
    handles = (
        level_bar(rng, wall, 0.0, rng.uniform(0.2, 0.8) * wide),
        upright_bar(rng, wall, 0.0, rng.uniform(0.5, 0.8) * high),
        knob(rng, wall, 0.0),
        ring(rng, wall),
    )
    geoms = (
        box((0, 0, 0), (wall, wide, high), rng.uniform(0.3, 1.0))
        + box((-deep, 0, -high + wall), (deep - wall, wide - wall, wall / 2), rng.uniform(0.3, 1.5))
        + handles[rng.integers(len(handles))]
    )
    start = float(rng.choice([0.0, rng.uniform(0.05, 0.3) * travel]))
    target = min(start + rng.uniform(0.05, 0.18), 0.95 * travel)
    if start > 0.04 and rng.random() < 0.5:
        target = 0.0
    friction, damping = uniform(rng, (1.0, 6.0), (1.0, 10.0))
    part = Part((wall, 0, 0), True, (1, 0, 0), (0.0, travel), start, friction, damping, geoms)
    return Fitting(case(wide + gap, high + gap, deep), part, high + 0.03 + rng.uniform(0.05, 0.5), target)


def door(rng: Rng) -> Fitting:
    """A leaf before a case, hinged at its left or right, with a bar or a knob."""
    wide, high, thick = uniform(rng, (0.12, 0.24), (0.12, 0.28), (0.006, 0.012))
    side = float(rng.choice([-1.0, 1.0]))  # of the hinge
    y = -side * (2.0 * wide - rng.uniform(0.03, 0.05))
    bar = upright_bar(rng, thick, y, rng.uniform(0.15, 0.5) * high)
    handle = bar if rng.random() < 0.6 else knob(rng, thick, y)
    leaf = box((0, -side * wide, 0), (thick, wide, high), rng.uniform(1.0, 4.0))
    start = float(rng.choice([0.0, rng.uniform(0.2, 0.8)]))
    opens = start == 0.0 or rng.random() < 0.5
    friction, damping = uniform(rng, (0.2, 2.0), (0.2, 2.0))
    at = (thick + 0.002, side * wide, 0.0)
    part = Part(at, False, (0, 0, side), (0.0, 2.0), start, friction, damping, leaf + handle)
    target = start + rng.uniform(0.4, 1.2) if opens else 0.0
    return Fitting(
        case(wide, high, rng.uniform(0.1, 0.18)), part, high + 0.03 + rng.uniform(0.0, 0.3), target
    )


def chest_lid(rng: Rng) -> Fitting:
    """A lid on a box, hinged at the back, that stands out over the front."""
    wide, deep, high = uniform(rng, (0.1, 0.22), (0.08, 0.16), (0.06, 0.16))
    over, thick, mass = uniform(rng, (0.012, 0.04), (0.004, 0.008), (0.2, 1.0))
    walls = "".join(
        box((x, y, -high / 2), (half_x, half_y, high / 2))
        for x, y, half_x, half_y in (
            (deep, wide - 0.008, deep, 0.008),
            (deep, -wide + 0.008, deep, 0.008),
            (0.008, 0.0, 0.008, wide),
            (2.0 * deep - 0.008, 0.0, 0.008, wide),
        )
    )
    lid = box((deep + over / 2.0, 0, 0), (deep + over / 2.0, wide, thick), mass)
    start = float(rng.choice([0.0, rng.uniform(0.3, 1.2)]))
    holds = holding(rng, mass, deep + over / 2.0)
    part = Part(
        (0, 0, thick + 0.001), False, (0, -1, 0), (0.0, 1.9), start, holds, rng.uniform(0.1, 1.0), lid
    )
    target = start + rng.uniform(0.3, 0.7) * (1.0 if start < 0.9 else -1.0)
    return Fitting(walls, part, high + rng.uniform(0.0, 0.3), target)


def oven_flap(rng: Rng) -> Fitting:
    """A flap hinged at its lower edge, with a level bar at its upper one."""
    wide, high, thick, mass = uniform(rng, (0.15, 0.25), (0.1, 0.18), (0.008, 0.014), (0.5, 2.0))
    bar = level_bar(rng, thick, 2.0 * high - 0.035, rng.uniform(0.5, 0.9) * wide)
    start = float(rng.choice([0.0, rng.uniform(0.3, 0.8)]))
    holds, damping = holding(rng, mass, high), rng.uniform(0.5, 2.0)
    flap = box((0, 0, high), (thick, wide, high), mass) + bar
    part = Part((thick + 0.002, 0, -high), False, (0, 1, 0), (0.0, 1.5), start, holds, damping, flap)
    frame = case(wide, high, rng.uniform(0.1, 0.18))
    return Fitting(frame, part, high + 0.03 + rng.uniform(0.02, 0.3), start + rng.uniform(0.3, 0.65))


def notebook(rng: Rng) -> Fitting:
    """A thin screen on a thin base, half open."""
    wide, deep, mass = uniform(rng, (0.12, 0.18), (0.09, 0.13), (0.2, 0.6))
    start = rng.uniform(0.7, 1.9)
    holds, damping = holding(rng, mass, deep), rng.uniform(0.02, 0.3)
    screen = box((deep, 0, 0), (deep, wide, 0.004), mass)
    part = Part((-0.006, 0, 0.026), False, (0, -1, 0), (0.0, 2.4), start, holds, damping, screen)
    target = float(np.clip(start + either(rng) * rng.uniform(0.3, 0.7), 0.35, 2.3))
    return Fitting(box((deep, 0, 0.009), (deep, wide, 0.009)), part, rng.uniform(0.0, 0.25), target)


def lever_tap(rng: Rng) -> Fitting:
    """A lever on a post, level or slanted, that turns about an upright axis."""
    long, thick, high, tilt = uniform(rng, (0.05, 0.14), (0.006, 0.012), (0.08, 0.2), (0.0, 0.5))
    tip = (long * math.cos(tilt), 0.0, long * math.sin(tilt))
    hub = f'<geom type="cylinder" size="{1.6 * thick:.4f} {thick:.4f}" mass="0.1"/>'
    geoms = hub + capsule((0, 0, 0), tip, thick, rng.uniform(0.05, 0.3))
    post = (
        f'<geom type="cylinder" size="{1.8 * thick:.4f} {high / 2:.4f}" pos="0 0 {-high / 2 - thick:.4f}"/>'
    )
    start = rng.uniform(-0.7, 0.7)
    friction, damping = uniform(rng, (0.1, 0.8), (0.02, 0.3))
    part = Part((0, 0, 0.001), False, (0, 0, 1), (-1.6, 1.6), start, friction, damping, geoms)
    target = float(np.clip(start + either(rng) * rng.uniform(0.3, 1.2), -1.5, 1.5))
    return Fitting(post, part, high + rng.uniform(0.03, 0.3), target)


def hand_wheel(rng: Rng) -> Fitting:
    """A wheel with spokes, lying, leaning or upright, without limits."""
    radius, spokes = rng.uniform(0.07, 0.14), int(rng.integers(2, 6))
    rim = circle(radius, 21)
    arms = circle(radius, spokes + 1)[:-1]
    geoms = '<geom type="cylinder" size=".02 .012" mass=".2"/>'
    geoms += "".join(capsule(a, b, 0.008, 0.03) for a, b in itertools.pairwise(rim))
    geoms += "".join(capsule((0, 0, 0), tip, 0.008, 0.03) for tip in arms)
    lean = float(rng.choice([0.0, rng.uniform(0.2, 1.2), math.pi / 2]))
    axis = (math.sin(lean), 0.0, math.cos(lean))
    foot = tuple(-0.12 * value for value in axis)
    neck = tuple(-0.033 * value for value in axis)
    friction, damping = uniform(rng, (0.1, 1.0), (0.02, 0.3))
    wheel = Leaning((0, 0, 0), False, (0, 0, 1), None, 0.0, friction, damping, geoms, lean)
    stand = f'<geom type="capsule" fromto="{numbers(neck)} {numbers(foot)}" size=".02"/>'
    z_m = (radius + 0.01) * math.sin(lean) + 0.15 * math.cos(lean) + rng.uniform(0.05, 0.3)
    return Fitting(stand, wheel, z_m, float(either(rng) * rng.uniform(0.4, 2.5)))


@dataclass(frozen=True)
class Leaning(Part):
    """A part in a frame that leans forward by ``lean`` [rad]."""

    lean: float

    @property
    def mjcf(self) -> str:
        return f'<body euler="0 {self.lean:.4f} 0">{super().mjcf}</body>'


def sliding_pane(rng: Rng) -> Fitting:
    """A pane that slides sideways between two rails, with an upright grip."""
    wide, high = uniform(rng, (0.1, 0.2), (0.1, 0.22))
    grip = upright_bar(rng, 0.006, rng.uniform(-0.6, 0.6) * wide, rng.uniform(0.3, 0.6) * high)
    travel = 1.8 * wide
    start = rng.uniform(0.0, travel)
    target = float(np.clip(start + either(rng) * rng.uniform(0.05, 0.25), 0.0, 0.99 * travel))
    if abs(target - start) < 0.03:
        target = travel - start
    friction, damping = uniform(rng, (1.0, 8.0), (1.0, 10.0))
    pane = box((0, 0, 0), (0.006, wide, high), rng.uniform(0.5, 2.0)) + grip
    part = Part((0, 0, 0), True, (0, 1, 0), (0.0, travel), start, friction, damping, pane)
    rails = "".join(
        box((-0.02, wide, side * (high + 0.012)), (0.03, 2.1 * wide, 0.01)) for side in (-1.0, 1.0)
    )
    return Fitting(rails, part, high + 0.03 + rng.uniform(0.05, 0.3), target)


def bin_lid(rng: Rng) -> Fitting:
    """A round lid on a pail, hinged at the back, with a tongue at the front."""
    radius, high, mass, tongue = uniform(rng, (0.09, 0.16), (0.15, 0.3), (0.1, 0.5), (0.015, 0.04))
    lid = f'<geom type="cylinder" pos="{radius:.4f} 0 0" size="{radius:.4f} .006" mass="{mass:.3f}"/>'
    lid += box((2.0 * radius + tongue / 2, 0, 0), (tongue, 0.025, 0.005), 0.03)
    pail = f'<geom type="cylinder" pos="{radius:.4f} 0 {-high / 2:.4f}" size="{0.97 * radius:.4f} {high / 2:.4f}"/>'
    start = float(rng.choice([0.0, rng.uniform(0.2, 0.9)]))
    holds, damping = holding(rng, mass + 0.03, 1.2 * radius), rng.uniform(0.02, 0.4)
    part = Part((0, 0, 0.008), False, (0, -1, 0), (0.0, 1.6), start, holds, damping, lid)
    return Fitting(pail, part, high + rng.uniform(0.0, 0.2), start + rng.uniform(0.3, 0.6))


def flap_up(rng: Rng) -> Fitting:
    """A flap hinged at its upper edge, with a bar at its lower one."""
    wide, high, thick, mass = uniform(rng, (0.12, 0.22), (0.08, 0.15), (0.006, 0.01), (0.3, 1.0))
    bar = level_bar(rng, thick, -2.0 * high + 0.03, rng.uniform(0.3, 0.8) * wide)
    flap = box((0, 0, -high), (thick, wide, high), mass) + bar
    holds, damping = holding(rng, mass, high), rng.uniform(0.2, 1.0)
    part = Part((thick + 0.002, 0, high), False, (0, -1, 0), (0.0, 1.6), 0.0, holds, damping, flap)
    frame = case(wide, high, rng.uniform(0.1, 0.15))
    return Fitting(frame, part, high + 0.03 + rng.uniform(0.1, 0.35), rng.uniform(0.3, 0.9))


FAMILIES: tuple[Callable[[Rng], Fitting], ...] = (
    drawer, door, chest_lid, oven_flap, notebook, lever_tap, hand_wheel, sliding_pane, bin_lid, flap_up,
)  # fmt: skip


def scene(seed: int) -> tuple[str, str, float]:
    """Scene ``seed`` on a floor before an arm at the origin.

    Returns:
        Its MJCF with the joint "part", the name of its family, and the joint's target [m or rad].
    """
    rng = np.random.default_rng((20, seed))
    family = FAMILIES[seed % len(FAMILIES)]
    drawn = family(rng)
    away, aside = uniform(rng, (0.5, 0.75), (-0.6, 0.6))
    x, y, turn = away * math.cos(aside), away * math.sin(aside), math.pi + aside + rng.uniform(-0.5, 0.5)
    text = (
        f'<mujoco model="{family.__name__}"><compiler angle="radian"/><worldbody>'
        '<geom name="floor" type="plane" size="3 3 .1"/><site name="arm_base"/>'
        f'<body name="object" pos="{x:.4f} {y:.4f} {drawn.z_m:.4f}" euler="0 0 {turn:.4f}">'
        f"{drawn.fixed}{drawn.part.mjcf}</body></worldbody></mujoco>\n"
    )
    return text, family.__name__, drawn.target


def case(wide: float, high: float, deep: float) -> str:
    """A case of 10 mm walls around the space behind the plane x = 0, open there."""
    wall = 0.005
    return (
        box((-deep, wide + wall, 0), (deep, wall, high + 2.0 * wall))
        + box((-deep, -wide - wall, 0), (deep, wall, high + 2.0 * wall))
        + box((-deep, 0, high + wall), (deep, wide, wall))
        + box((-deep, 0, -high - wall), (deep, wide, wall))
        + box((-2.0 * deep - wall, 0, 0), (wall, wide, high))
    )


def level_bar(rng: Rng, face: float, z: float, half: float) -> str:
    """A bar along y on two feet before a face at x = ``face``."""
    return bar_on_feet(rng, face, (0.0, half, 0.0), (0.0, z))


def upright_bar(rng: Rng, face: float, y: float, half: float) -> str:
    """A bar along z on two feet before a face at x = ``face``."""
    return bar_on_feet(rng, face, (0.0, 0.0, half), (y, 0.0))


def bar_on_feet(rng: Rng, face: float, half: Triple, middle: tuple[float, float]) -> str:
    out, thick = face + rng.uniform(0.03, 0.055), rng.uniform(0.005, 0.009)
    (y, z), ends = middle, []
    for side in (-1.0, 1.0):
        ends.append((out, y + side * half[1], z + side * half[2]))
    feet = "".join(capsule((face, end[1], end[2]), end, thick, 0.02) for end in ends)
    return feet + capsule(ends[0], ends[1], thick, 0.05)


def knob(rng: Rng, face: float, y: float) -> str:
    """A ball on a stem before a face at x = ``face``."""
    out, radius = face + rng.uniform(0.035, 0.05), rng.uniform(0.013, 0.022)
    ball = f'<geom type="sphere" pos="{numbers((out, y, 0.0))}" size="{radius:.4f}" mass=".03"/>'
    return capsule((face, y, 0.0), (out, y, 0.0), 0.007, 0.02) + ball


def ring(rng: Rng, face: float) -> str:
    """A level ring that stands out from a face at x = ``face``."""
    radius = rng.uniform(0.025, 0.04)
    points = [(face + radius + x, y, z) for x, y, z in circle(radius, 13)]
    return "".join(capsule(a, b, 0.005, 0.01) for a, b in itertools.pairwise(points))


def holding(rng: Rng, mass: float, lever_m: float) -> float:
    """Dry friction that holds a flap wherever it is, 1.2 to 3 times what gravity takes [N·m]."""
    return float(9.81 * mass * lever_m * rng.uniform(1.2, 3.0))


def circle(radius: float, points: int) -> list[Triple]:
    """Points on a level circle, the last one the first again."""
    angles = np.linspace(0.0, 2.0 * np.pi, points)
    return [(radius * math.cos(a), radius * math.sin(a), 0.0) for a in angles]


def box(at: Triple, half: Triple, mass: float | None = None) -> str:
    weight = "" if mass is None else f' mass="{mass:.3f}"'
    return f'<geom type="box" pos="{numbers(at)}" size="{numbers(half)}"{weight}/>'


def capsule(a: Triple, b: Triple, radius: float, mass: float) -> str:
    return f'<geom type="capsule" fromto="{numbers(a)} {numbers(b)}" size="{radius:.4f}" mass="{mass:.3f}"/>'


def numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.4f}" for value in values)


def uniform(rng: Rng, *ranges: tuple[float, float]) -> tuple[float, ...]:
    return tuple(float(rng.uniform(low, high)) for low, high in ranges)


def either(rng: Rng) -> float:
    """A sense, 1 or -1."""
    return float(rng.choice([-1.0, 1.0]))
