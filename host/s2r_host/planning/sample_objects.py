"""Small procedural objects to plan on, as MJCF text: for tests, examples and benchmarks of the planner.

They follow the object file's convention: bodies ``object_base`` and ``object_part``, joint ``object_joint``, world
frame = arm base frame, table at z = 0. They are made of boxes; the twins of real objects come from the model builder.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DrawerShape:
    """A cabinet with one drawer and a horizontal bar handle. Lengths in m, SI units.

    Attributes:
        x, y: Centre of the closed drawer's front face on the table, world frame.
        yaw: Turn of the cabinet about z [rad]; 0: the front's outward normal is -x.
        width, height, depth: Of the cabinet.
        bottom: Height of the drawer's lower edge above the table.
        front_height: Of the drawer's front panel.
        handle_gap: Free gap between front and bar.
        handle_length, handle_thick: Of the bar.
        opening: How far it is open where the joint reads 0.
        travel: Largest opening.
        mass: Of the drawer.
        damping: Of the slide [N·s/m].
        friction: Dry friction of the slide [N].
    """

    x: float = 0.55
    y: float = 0.0
    yaw: float = 0.0
    width: float = 0.32
    height: float = 0.22
    depth: float = 0.30
    bottom: float = 0.10
    front_height: float = 0.11
    handle_gap: float = 0.035
    handle_length: float = 0.12
    handle_thick: float = 0.012
    opening: float = 0.07
    travel: float = 0.28
    mass: float = 1.5
    damping: float = 20.0
    friction: float = 5.0


def random_drawer(rng: np.random.Generator) -> DrawerShape:
    """A drawer of a random shape and place in front of the arm, within what a table-top cabinet looks like."""
    height = rng.uniform(0.16, 0.28)
    front_height = rng.uniform(0.08, 0.13)
    return DrawerShape(
        x=rng.uniform(0.52, 0.60),
        y=rng.uniform(-0.08, 0.08),
        yaw=rng.uniform(-0.25, 0.25),
        width=rng.uniform(0.26, 0.38),
        height=height,
        depth=rng.uniform(0.24, 0.32),
        bottom=rng.uniform(0.02, max(height - front_height - 0.03, 0.03)),
        front_height=front_height,
        handle_gap=rng.uniform(0.030, 0.045),
        handle_length=rng.uniform(0.09, 0.16),
        handle_thick=rng.uniform(0.010, 0.014),
        opening=rng.uniform(0.05, 0.10),
        travel=0.30,
        mass=rng.uniform(0.8, 2.5),
        damping=rng.uniform(8.0, 40.0),
        friction=rng.uniform(2.0, 8.0),
    )


def drawer_mjcf(shape: DrawerShape) -> str:
    """The drawer as MJCF text; ``object_joint`` is 0 at ``shape.opening`` and grows outwards."""
    s, wall = shape, 0.012
    half_w, mid = s.width / 2, s.bottom + s.front_height / 2
    above = s.height - wall - s.bottom - s.front_height
    base = [
        _box(
            "base_left", (s.depth / 2, half_w - wall / 2, s.height / 2), (s.depth / 2, wall / 2, s.height / 2)
        ),
        _box(
            "base_right",
            (s.depth / 2, -half_w + wall / 2, s.height / 2),
            (s.depth / 2, wall / 2, s.height / 2),
        ),
        _box("base_top", (s.depth / 2, 0, s.height - wall / 2), (s.depth / 2, half_w, wall / 2)),
        _box("base_back", (s.depth - wall / 2, 0, s.height / 2), (wall / 2, half_w, s.height / 2)),
    ]
    if s.bottom > 0.02:
        base.append(
            _box("base_lower", (s.depth / 2, 0, s.bottom / 2), (s.depth / 2, half_w, s.bottom / 2 - 0.001))
        )
    if above > 0.01:
        z = s.height - wall - above / 2
        base.append(_box("base_upper", (wall / 2, 0, z), (wall / 2, half_w - wall, above / 2 - 0.001)))
    inner_w, inner_d, floor = half_w - wall - 0.004, s.depth - 0.03, s.bottom + 0.01
    wall_z, wall_h = s.bottom + 0.35 * s.front_height, 0.35 * s.front_height
    grip = s.handle_gap + s.handle_thick / 2
    post = s.handle_length / 2 - 0.006
    part = [
        _box("part_front", (-0.006, 0, mid), (0.006, half_w - 0.002, s.front_height / 2 - 0.002)),
        _box("part_floor", (inner_d / 2, 0, floor), (inner_d / 2, inner_w, 0.004)),
        _box("part_left", (inner_d / 2, inner_w, wall_z), (inner_d / 2, 0.004, wall_h)),
        _box("part_right", (inner_d / 2, -inner_w, wall_z), (inner_d / 2, 0.004, wall_h)),
        _box("part_back", (inner_d, 0, wall_z), (0.004, inner_w, wall_h)),
        _box(
            "part_bar", (-0.012 - grip, 0, mid), (s.handle_thick / 2, s.handle_length / 2, s.handle_thick / 2)
        ),
        _box("part_post_l", (-0.012 - grip / 2, post, mid), (grip / 2, 0.005, 0.005)),
        _box("part_post_r", (-0.012 - grip / 2, -post, mid), (grip / 2, 0.005, 0.005)),
    ]
    return f"""<mujoco model="drawer">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="object_base" pos="{s.x} {s.y} 0" euler="0 0 {s.yaw}">
      {"".join(base)}
      <body name="object_part" pos="{-s.opening} 0 0">
        <joint name="object_joint" type="slide" axis="-1 0 0" range="{-s.opening} {s.travel - s.opening}"
               damping="{s.damping}" frictionloss="{s.friction}"/>
        <inertial pos="0.1 0 {mid}" mass="{s.mass}" diaginertia="0.02 0.02 0.02"/>
        {"".join(part)}
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def lid_mjcf(x: float = 0.50, y: float = 0.0, yaw: float = 0.0, opening: float = 1.0) -> str:
    """A laptop: base on the table, lid hinged at the far edge; ``object_joint`` is 0 at ``opening`` rad and opens."""
    return f"""<mujoco model="laptop">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="object_base" pos="{x} {y} 0" euler="0 0 {yaw}">
      {_box("base_body", (0, 0, 0.009), (0.11, 0.15, 0.009))}
      <body name="object_part" pos="0.11 0 0.022" euler="0 {opening} 0">
        <joint name="object_joint" type="hinge" axis="0 1 0" range="{-opening} {2.2 - opening}"
               damping="0.3" frictionloss="1.2"/>
        <inertial pos="-0.1 0 0" mass="0.5" diaginertia="0.004 0.002 0.006"/>
        {_box("part_lid", (-0.108, 0, 0.004), (0.108, 0.15, 0.004))}
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True)
class DoorShape:
    """A cabinet with a door on a vertical hinge and a vertical bar handle. Lengths in m.

    Attributes:
        x, y: Middle of the closed door's front on the table, world frame.
        yaw: Turn of the cabinet about z [rad].
        width, height, depth: Of the cabinet.
        handle_gap: Free gap between door and bar.
        ajar: Opening where the joint reads 0 [rad].
        damping: Of the hinge [N·m·s/rad].
        friction: Dry friction of the hinge [N·m].
    """

    x: float = 0.60
    y: float = 0.0
    yaw: float = 0.0
    width: float = 0.24
    height: float = 0.30
    depth: float = 0.20
    handle_gap: float = 0.035
    ajar: float = 0.15
    damping: float = 0.5
    friction: float = 0.4


def door_mjcf(shape: DoorShape) -> str:
    """The door as MJCF text; hinge on its left side seen from the arm; ``object_joint`` grows as it opens."""
    s, wall = shape, 0.010
    half_w, half_h = s.width / 2, s.height / 2
    base = [
        _box("base_left", (s.depth / 2, half_w, half_h), (s.depth / 2, wall / 2, half_h)),
        _box("base_right", (s.depth / 2, -half_w, half_h), (s.depth / 2, wall / 2, half_h)),
        _box("base_top", (s.depth / 2, 0, s.height), (s.depth / 2, half_w, wall / 2)),
        _box("base_floor", (s.depth / 2, 0, wall / 2), (s.depth / 2, half_w, wall / 2)),
        _box("base_back", (s.depth, 0, half_h), (wall / 2, half_w, half_h)),
    ]
    grip, post_z, reach = s.handle_gap + 0.006, 0.05, 0.86 * s.width
    part = [
        _box("part_leaf", (-0.008, -half_w, half_h), (0.006, half_w - 0.003, half_h - 0.012)),
        _box("part_bar", (-0.014 - grip, -reach, half_h), (0.006, 0.006, post_z + 0.006)),
        _box("part_post_low", (-0.014 - grip / 2, -reach, half_h - post_z), (grip / 2, 0.005, 0.005)),
        _box("part_post_high", (-0.014 - grip / 2, -reach, half_h + post_z), (grip / 2, 0.005, 0.005)),
    ]
    return f"""<mujoco model="door">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="object_base" pos="{s.x} {s.y} 0" euler="0 0 {s.yaw}">
      {"".join(base)}
      <body name="object_part" pos="0 {half_w} 0" euler="0 0 {-s.ajar}">
        <joint name="object_joint" type="hinge" axis="0 0 -1" range="{-s.ajar} {1.6 - s.ajar}"
               damping="{s.damping}" frictionloss="{s.friction}"/>
        <inertial pos="-0.01 {-half_w} {half_h}" mass="1.2" diaginertia="0.012 0.010 0.006"/>
        {"".join(part)}
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def faucet_mjcf(x: float = 0.52, y: float = 0.0, yaw: float = 0.0) -> str:
    """A faucet: a column with a 12 cm lever that turns about z; ``object_joint`` is 0 with the lever towards -x."""
    return f"""<mujoco model="faucet">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="object_base" pos="{x} {y} 0" euler="0 0 {yaw}">
      {_box("base_column", (0, 0, 0.09), (0.022, 0.022, 0.09))}
      <body name="object_part" pos="0 0 0.195">
        <joint name="object_joint" type="hinge" axis="0 0 1" range="-1.4 1.4" damping="0.2" frictionloss="0.3"/>
        <inertial pos="-0.06 0 0" mass="0.3" diaginertia="0.0005 0.0005 0.0005"/>
        {_box("part_lever", (-0.06, 0, 0), (0.06, 0.010, 0.012))}
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def _box(name: str, centre: tuple[float, float, float], half: tuple[float, float, float]) -> str:
    numbers = [" ".join(f"{v:.6f}" for v in values) for values in (centre, half)]
    return f'<geom name="{name}" type="box" pos="{numbers[0]}" size="{numbers[1]}"/>\n      '
