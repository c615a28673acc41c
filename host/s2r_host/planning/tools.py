"""Tools held by the gripper: the same arm with a longer or wider end, as an arm description of its own.

A tool changes kinematics, inertia and shapes, so it changes the model's hash too: host and executor must be started
with the same folder. The fingers hold the tool and are no longer meant to touch the part; the tool's shapes are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import yaml

from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.arms.source import FINGER_PREFIX
from s2r_protocol.exits import UsageError

_GRIP_DEPTH_M = 0.04  # how deep a tool's stem sits between the fingers


@dataclass(frozen=True)
class HandTool:
    """A rigid tool in the frame of the fingertip: z along the gripper, x across the fingers.

    Attributes:
        name: Part of the arm's new name.
        mass_kg: Of a stem and rods of aluminium.
        rods: Capsules: two ends [m] and a radius [m].
        tip_m: Centre of its end face on the z axis.
    """

    name: str
    mass_kg: float
    rods: tuple[tuple[tuple[float, float, float], tuple[float, float, float], float], ...]
    tip_m: float


def t_shape(length_m: float = 0.18, width_m: float = 0.08) -> HandTool:
    """A stem with a crossbar at its end, across the fingers."""
    half = width_m / 2.0
    bar_z = length_m - 0.006
    stem = ((0.0, 0.0, -_GRIP_DEPTH_M), (0.0, 0.0, bar_z), 0.006)
    return HandTool("t_shape", 0.12, (stem, ((-half, 0.0, bar_z), (half, 0.0, bar_z), 0.006)), length_m)


def semi_ring(length_m: float = 0.18, radius_m: float = 0.03, pieces: int = 6) -> HandTool:
    """A stem with half a ring at its end that opens forwards, in the plane across the fingers."""
    centre = length_m - 0.006
    arc = [
        (radius_m * math.cos(a), 0.0, centre - radius_m * math.sin(a))
        for a in (math.pi * k / pieces for k in range(pieces + 1))
    ]
    rods = tuple((arc[k], arc[k + 1], 0.006) for k in range(pieces))
    stem = ((0.0, 0.0, -_GRIP_DEPTH_M), (0.0, 0.0, centre - radius_m), 0.006)
    return HandTool("semi_ring", 0.13, (stem, *rods), length_m)


TOOLS = {"t_shape": t_shape, "semi_ring": semi_ring}


def tool_named(name: str) -> HandTool:
    """A tool by its name.

    Raises:
        UsageError: There is no such tool.
    """
    if name not in TOOLS:
        raise UsageError(f"unknown tool {name!r}; there are {', '.join(TOOLS)}")
    return TOOLS[name]()


def write_arm_with_tool(arm: ArmDescription, tool: HandTool, folder: Path) -> ArmDescription:
    """Write an ``arm.yaml`` of the arm with the tool between its fingers, and load it."""
    source = arm.source.model_dump(mode="json")
    tip = source["tool"]
    for shape in source["shapes"]:
        if shape["name"].startswith(FINGER_PREFIX):
            shape["name"] = f"holding_{shape['name']}"
    link = f"{tool.name}_link"
    source["name"] = f"{arm.name}_{tool.name}"
    reach = tool.tip_m + _GRIP_DEPTH_M
    inertia = max(tool.mass_kg * reach**2 / 12.0, 1e-5)
    source["links"].append(
        {
            "name": link,
            "mass": tool.mass_kg,
            "com": [0.0, 0.0, (tool.tip_m - _GRIP_DEPTH_M) / 2.0],
            "inertia": [inertia, inertia, 0.5 * inertia],
        }
    )
    source["mounts"].append(
        {"parent": tip["parent"], "child": link, "origin": tip["origin"], "rpy": tip["rpy"]}
    )
    source["shapes"] += [
        {
            "link": link,
            "name": f"{FINGER_PREFIX}_{tool.name}_{k}",
            "type": "capsule",
            "a": a,
            "b": b,
            "radius": r,
        }
        for k, (a, b, r) in enumerate(tool.rods)
    ]
    # What holds the tool is never checked against it.
    holders = {shape["link"] for shape in source["shapes"] if shape["name"].startswith("holding_")}
    source["collision_exclude"] += [[holder, link] for holder in sorted(holders - {tip["parent"]})]
    source["tool"] = {
        "name": tip["name"],
        "parent": link,
        "origin": [0.0, 0.0, tool.tip_m],
        "rpy": [0.0, 0.0, 0.0],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.yaml").write_text(yaml.safe_dump(source, sort_keys=False, default_flow_style=None))
    return load_arm(folder)
