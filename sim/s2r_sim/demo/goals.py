"""What the demo asks for, per kind of object, and how exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass

from s2r_protocol.targets import TARGETS, Targets


@dataclass(frozen=True)
class Goal:
    """A kind's default request and success band.

    Attributes:
        name: The kind.
        targets: Of the kind that the host is told it is.
        target: Default joint value, as on the command line.
        tolerance: True error that still counts as a success [m or rad].
    """

    name: str
    targets: Targets
    target: str
    tolerance: float


GOALS = {
    goal.name: goal
    for goal in (
        Goal("drawer", TARGETS["drawer"], "150mm", 0.005),
        Goal("drawers", TARGETS["drawer"], "100mm", 0.005),
        Goal("laptop", TARGETS["laptop"], "-35deg", math.radians(2.0)),
        Goal("faucet", TARGETS["faucet"], "30deg", math.radians(3.0)),
    )
}
