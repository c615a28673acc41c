"""What of an arm the bus can carry. Both packings have the same units and slots; the core refuses the rest."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from s2r_protocol.arms.description import ArmDescription
from s2r_protocol.can.units import COUNTS_PER_RAD, VELOCITY_UNIT

MOST_JOINTS = 7  # slots of the packed SET frame
LOWEST_RAD, HIGHEST_RAD = -(2**31) / COUNTS_PER_RAD, (2**31 - 1) / COUNTS_PER_RAD
FASTEST_RAD_S = (2**15 - 1) * VELOCITY_UNIT

_RANGES = (
    ("q_min", LOWEST_RAD, HIGHEST_RAD, "rad"),
    ("q_max", LOWEST_RAD, HIGHEST_RAD, "rad"),
    ("dq_max", 1e-3, FASTEST_RAD_S, "rad/s"),
    ("ddq_max", 1e-3, 1e4, "rad/s²"),
    ("dddq_max", 1e-3, 1e7, "rad/s³"),
    ("tau_max", 1e-6, 1e5, "N·m"),
)


@dataclass(frozen=True)
class OffBus:
    """A number of an arm that the executor refuses; ``what`` is which, ``text`` a clause, ``fix`` the next step."""

    what: str
    text: str
    fix: str


def off_bus(arm: ArmDescription) -> Iterator[OffBus]:
    """Everything about an arm that the bus cannot carry, joint by joint."""
    if arm.dof > MOST_JOINTS:
        text = f"{arm.dof} joints, the bus carries {MOST_JOINTS}"
        yield OffBus("joints", text, "plans can be made for this arm; no executor moves it")
    limits = arm.limits.as_dict()
    for index, joint in enumerate(arm.joint_names):
        for field, low, high, unit in _RANGES:
            value = limits[field][index]
            if not low <= value <= high:
                text = (
                    f"joint '{joint}' (index {index}): {field} = {value:g} {unit} is outside "
                    f"[{low:g}, {high:g}] {unit}, what the bus carries"
                )
                yield OffBus(f"{joint}.{field}", text, _fix(value, low, high, unit))


def _fix(value: float, low: float, high: float, unit: str) -> str:
    radians = math.radians(value)
    if unit.startswith("rad") and abs(value) > 1.0 and low <= radians <= high:
        return f"degrees? {value:g}{unit.replace('rad', '°', 1)} are {radians:.4g} {unit}"
    return "bring the limit inside; the drives can be told no more"
