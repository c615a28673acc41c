"""What the demo asks for, per kind of object, and how exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Goal:
    """A kind's default request and success band.

    Attributes:
        name: The kind.
        task: What the host is told it is.
        target: Default joint value, as on the command line.
        tolerance: True error that still counts as a success [m or rad].
        unit, factor: For people: its name and how many of them make one metre or radian.
    """

    name: str
    task: str
    target: str
    tolerance: float
    unit: str
    factor: float


GOALS = {
    goal.name: goal
    for goal in (
        Goal("drawer", "drawer", "150mm", 0.005, "mm", 1e3),
        Goal("drawers", "drawer", "100mm", 0.005, "mm", 1e3),
        Goal("laptop", "laptop", "-35deg", math.radians(2.0), "°", math.degrees(1.0)),
        Goal("faucet", "faucet", "30deg", math.radians(3.0), "°", math.degrees(1.0)),
    )
}
