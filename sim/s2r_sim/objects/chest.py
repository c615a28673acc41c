"""A procedural chest of drawers: one to four rows, one or two columns, one drawer moves, or all of them.

Object frame: origin on the table below the middle of the carcass's front plane, x out of the chest, z up. The
joint coordinate is 0 when closed and positive outwards.
"""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
from pydantic import Field, model_validator

from s2r_sim.objects.naming import BASE_BODY, PART_BODY, other_part
from s2r_sim.objects.parameters import Rgb, Standing, tinted, uniform
from s2r_sim.objects.solids import Finish, box, rod, share_mass, slide, stand

HANDLES = ("bar", "upright", "knob", "lip", "none")
GAP_M = 0.002


class ChestSpec(Standing):
    """One chest of drawers.

    Attributes:
        width_m, height_m, depth_m: Of the carcass.
        wall_m: Thickness of its walls.
        rows, columns, row, column: Which drawer of how many moves; row 0 is the lowest.
        others: How far the other drawers are open, row by row from the lowest [m]; empty: they do not move.
        front_thickness_m: Of every front.
        handle: Form of every handle.
        handle_size_m: Length of a bar, diameter of a knob, width of a lip.
        handle_gap_m: Free space behind a bar, length of a knob, depth of a lip.
        handle_bar_m: Thickness of a bar or lip.
        handle_height: Place on the front, 0 bottom to 1 top.
        axis_yaw_rad: The rail is this much off square.
    """

    kind: Literal["chest"] = "chest"
    width_m: float
    height_m: float
    depth_m: float
    wall_m: float
    rows: int = Field(ge=1)
    columns: int = Field(ge=1, le=2)
    row: int = Field(ge=0)
    column: int = Field(ge=0)
    others: tuple[float, ...] = ()
    front_thickness_m: float
    handle: Literal["bar", "upright", "knob", "lip", "none"]
    handle_size_m: float
    handle_gap_m: float
    handle_bar_m: float
    handle_height: float
    axis_yaw_rad: float
    front_rgb: Rgb
    body_rgb: Rgb
    handle_rgb: Rgb

    @property
    def places(self) -> list[tuple[int, int]]:
        """(row, column) of the other drawers, in the order of ``others``."""
        cells = [(row, column) for row in range(self.rows) for column in range(self.columns)]
        return [cell for cell in cells if cell != (self.row, self.column)]

    @model_validator(mode="after")
    def _places_and_states(self) -> ChestSpec:
        if self.row >= self.rows or self.column >= self.columns:
            raise ValueError(
                f"row {self.row}, column {self.column} is no place of {self.rows} rows and {self.columns} columns; "
                "they count from 0"
            )
        if self.others and len(self.others) != len(self.places):
            raise ValueError(
                f"others has {len(self.others)} entries, the chest has {len(self.places)} more drawers"
            )
        if any(not 0.0 <= opening <= self.q_max for opening in self.others):
            raise ValueError(f"others {self.others} are not all from 0 to q_max {self.q_max:g}")
        return self


def draw_chest(rng: np.random.Generator) -> ChestSpec:
    """Draw a chest that stands in reach."""
    columns = 1 if rng.uniform() < 0.7 else 2
    width = uniform(rng, 0.22, 0.45) if columns == 1 else uniform(rng, 0.40, 0.60)
    rows = int(rng.integers(1, 5))
    height = round(rows * uniform(rng, 0.09, min(0.22, 0.62 / rows)), 6)
    depth = uniform(rng, 0.25, 0.45)
    q_max = round(depth * uniform(rng, 0.55, 0.85), 6)
    q_start = round(q_max * uniform(rng, 0.0, 0.4), 6)
    handle = HANDLES[int(rng.choice(5, p=[0.4, 0.1, 0.25, 0.15, 0.1]))]
    size = {"bar": (0.06, 0.18), "upright": (0.05, 0.10), "knob": (0.018, 0.038), "lip": (0.05, 0.2)}
    row_height = height / rows
    low, high = size.get(handle, (0.02, 0.03))
    high = min(high, {"upright": 0.7 * row_height}.get(handle, 0.7 * width / columns))
    return ChestSpec(
        x_m=round(uniform(rng, 0.54, 0.66) + q_start, 6),
        y_m=uniform(rng, -0.08, 0.08),
        yaw_rad=uniform(rng, -0.3, 0.3),
        q_start=q_start,
        q_max=q_max,
        coulomb=uniform(rng, 1.0, 6.0),
        damping=uniform(rng, 2.0, 20.0),
        mass_kg=uniform(rng, 0.5, 4.0),
        friction=uniform(rng, 0.3, 0.6),
        width_m=width,
        height_m=height,
        depth_m=depth,
        wall_m=uniform(rng, 0.008, 0.018),
        rows=rows,
        columns=columns,
        row=int(rng.integers(rows)),
        column=int(rng.integers(columns)),
        front_thickness_m=uniform(rng, 0.010, 0.024),
        handle=handle,
        handle_size_m=uniform(rng, min(low, high), high),
        handle_gap_m=uniform(rng, 0.015, 0.030) if handle in ("knob", "lip") else uniform(rng, 0.025, 0.045),
        handle_bar_m=uniform(rng, 0.006, 0.014),
        handle_height=uniform(rng, 0.3, 0.85),
        axis_yaw_rad=uniform(rng, -0.015, 0.015),
        front_rgb=tinted(rng, 0.25, 0.9),
        body_rgb=tinted(rng, 0.25, 0.9),
        handle_rgb=tinted(rng, 0.3, 0.8),
    )


def draw_drawers(rng: np.random.Generator) -> ChestSpec:
    """Draw a chest in reach whose two drawers, one above the other, both move and stand open a little."""
    rows = 2
    depth = uniform(rng, 0.35, 0.45)
    open_m = [uniform(rng, 0.05, 0.10) for _ in range(rows)]
    row = int(rng.integers(rows))
    return ChestSpec.model_validate(
        draw_chest(rng).model_dump()
        | {
            "x_m": round(uniform(rng, 0.54, 0.62) + max(open_m), 6),
            "yaw_rad": uniform(rng, -0.15, 0.15),
            "q_start": open_m.pop(row),
            "q_max": round(depth * uniform(rng, 0.65, 0.85), 6),
            "depth_m": depth,
            "width_m": uniform(rng, 0.25, 0.40),
            "height_m": round(rows * uniform(rng, 0.12, 0.15), 6),
            "rows": rows,
            "columns": 1,
            "row": row,
            "column": 0,
            "others": tuple(open_m),
            "handle": "bar",
            "handle_size_m": uniform(rng, 0.08, 0.18),
            "handle_gap_m": uniform(rng, 0.032, 0.045),
        }
    )


def add_chest(world: mujoco.MjSpec, spec: ChestSpec) -> None:
    """Add carcass and drawers."""
    base, part = stand(world, spec)
    wood = Finish(spec.body_rgb, spec.friction)
    w, d, t = spec.width_m / 2, spec.depth_m, spec.wall_m
    cell = (spec.height_m - t) / spec.rows
    box(base, "base_left", (-d, w - t, 0), (0, w, spec.height_m), wood)
    box(base, "base_right", (-d, -w, 0), (0, -w + t, spec.height_m), wood)
    box(base, "base_back", (-d, -w + t, 0), (-d + t, w - t, spec.height_m), wood)
    for k in range(spec.rows + 1):
        box(base, f"base_shelf_{k}", (-d + t, -w + t, k * cell), (0, w - t, k * cell + t), wood)
    if spec.columns == 2:
        box(base, "base_divider", (-d + t, -t / 2, t), (0, t / 2, spec.height_m - t), wood)
    axis = (np.cos(spec.axis_yaw_rad), np.sin(spec.axis_yaw_rad), 0.0)
    _add_drawer(part, "part", spec, spec.row, spec.column)
    slide(part, spec, axis)
    for row, column in spec.places:
        if not spec.others:
            _shell(base, f"base_{row}_{column}", spec, *_front(spec, row, column))
            continue
        body_name, joint = other_part(f"{row}_{column}")
        body = base.add_body(name=body_name)
        for guide in (BASE_BODY, PART_BODY):  # the joint guides it, not the walls
            world.add_exclude(bodyname1=guide, bodyname2=body_name)
        _add_drawer(body, f"part_{row}_{column}", spec, row, column)
        slide(body, spec, axis, joint)


def other_drawers(spec: ChestSpec) -> dict[str, float]:
    """Joint values as found of the drawers that move besides the one told of [m], by joint name."""
    named = zip(spec.places, spec.others, strict=True) if spec.others else ()
    return {other_part(f"{row}_{column}")[1]: s for (row, column), s in named}


def _add_drawer(body: mujoco.MjsBody, name: str, spec: ChestSpec, row: int, column: int) -> None:
    """Front, handle and box of a drawer that moves."""
    low, high = _front(spec, row, column)
    share_mass(_shell(body, name, spec, low, high) + _drawer_box(body, name, spec, low, high), spec.mass_kg)


def _front(spec: ChestSpec, row: int, column: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a front that lies over the carcass's edges."""
    cell = (spec.height_m - spec.wall_m) / spec.rows
    width = spec.width_m / spec.columns
    y = -spec.width_m / 2 + column * width
    z = row * cell + spec.wall_m / 2
    low = np.array([0.0, y + GAP_M / 2, z + GAP_M / 2])
    return low, np.array([spec.front_thickness_m, y + width - GAP_M / 2, z + cell - GAP_M / 2])


def _shell(
    body: mujoco.MjsBody, name: str, spec: ChestSpec, low: np.ndarray, high: np.ndarray
) -> list[mujoco.MjsGeom]:
    """A front with its handle."""
    front = [box(body, f"{name}_front", low, high, Finish(spec.front_rgb, spec.friction))]
    metal = Finish(spec.handle_rgb, spec.friction)
    x, gap, b, half = high[0], spec.handle_gap_m, spec.handle_bar_m, spec.handle_size_m / 2
    y = (low[1] + high[1]) / 2
    z = low[2] + spec.handle_height * (high[2] - low[2])
    if spec.handle == "bar":
        z = float(np.clip(z, low[2] + b, high[2] - b))
        front.append(
            box(
                body, f"{name}_bar", (x + gap, y - half, z - b / 2), (x + gap + b, y + half, z + b / 2), metal
            )
        )
        ends = ((y - half, y - half + b), (y + half - b, y + half))
        for k, (y0, y1) in enumerate(ends):
            front.append(box(body, f"{name}_post_{k}", (x, y0, z - b / 2), (x + gap, y1, z + b / 2), metal))
    elif spec.handle == "upright":
        z = float(np.clip(z, low[2] + half, high[2] - half))
        front.append(
            box(
                body, f"{name}_bar", (x + gap, y - b / 2, z - half), (x + gap + b, y + b / 2, z + half), metal
            )
        )
        for k, (z0, z1) in enumerate(((z - half, z - half + b), (z + half - b, z + half))):
            front.append(box(body, f"{name}_post_{k}", (x, y - b / 2, z0), (x + gap, y + b / 2, z1), metal))
    elif spec.handle == "knob":
        front.append(rod(body, f"{name}_stem", (x, y, z), (x + gap / 2, y, z), 0.4 * half, metal))
        front.append(rod(body, f"{name}_knob", (x + gap / 2, y, z), (x + gap, y, z), half, metal))
    elif spec.handle == "lip":
        front.append(
            box(body, f"{name}_lip", (x, y - half, high[2] - b), (x + gap, y + half, high[2]), metal)
        )
    return front


def _drawer_box(
    part: mujoco.MjsBody, name: str, spec: ChestSpec, low: np.ndarray, high: np.ndarray
) -> list[mujoco.MjsGeom]:
    inside = Finish(spec.body_rgb, spec.friction)
    t, d = 0.6 * spec.wall_m, spec.depth_m - 2 * spec.wall_m
    y0, y1 = low[1] + spec.wall_m + 0.008, high[1] - spec.wall_m - 0.008
    z0, z1 = low[2] + spec.wall_m / 2 + 0.006, high[2] - spec.wall_m / 2 - 0.014
    return [
        box(part, f"{name}_floor", (-d, y0, z0), (0, y1, z0 + t), inside),
        box(part, f"{name}_left", (-d, y1 - t, z0 + t), (0, y1, z1), inside),
        box(part, f"{name}_right", (-d, y0, z0 + t), (0, y0 + t, z1), inside),
        box(part, f"{name}_rear", (-d, y0 + t, z0 + t), (-d + t, y1 - t, z1), inside),
    ]
