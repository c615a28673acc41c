"""What a run is about: the kind of object, the unit and sign of its joint, and how well it has to be moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

from s2r_protocol.exits import UsageError
from s2r_protocol.targets import TARGETS, JointType, Targets, Unit

Point = tuple[float, float, float]
"""x, y, z [m], base frame."""


@dataclass(frozen=True)
class Task:
    """A kind of object that ``s2r run`` can move. Joint values: 0 = as found in the first view.

    Attributes:
        targets: Its name on the command line, kind and unit of its joint, and what may be asked of it.
        part: The moving part, for sentences.
        tolerance: Measured error up to which a run counts as a success [m or rad].
        good_enough: Measured error that ends a run without another attempt. The camera is right within a fraction of
            this; a correction may err by more than the little it would gain.
        far_off: Error from which on the outcome says nothing about the pushed surface: the fingertip slipped instead.
        beside: How far beside where they are foreseen motions usually leave the part, one standard deviation.
        moving: Change per control step from which on the part counts as moved.
        told_to: Share of a turn that half its 90 % interval may be for the joint to be told; beyond it the part is
            pushed further while pushes are left. Of 85 levers six were told more vaguely than 0.12: their hinges were
            9 to 92 mm off. Of the other 79 six were more than 9 mm off.
    """

    targets: Targets
    part: str
    tolerance: float
    good_enough: float
    far_off: float
    beside: float
    moving: float
    told_to: float = 0.5

    @property
    def name(self) -> str:
        """On the command line."""
        return self.targets.kind

    @property
    def joint_type(self) -> JointType:
        """Of its joint."""
        return self.targets.joint_type

    @property
    def unit(self) -> Unit:
        """For people; computations are in m and rad."""
        return self.targets.unit

    @property
    def positive(self) -> str:
        """Where positive joint values lead, for sentences."""
        return self.targets.positive


DRAWER = Task(
    TARGETS["drawer"],
    "drawer",
    tolerance=0.005,
    good_enough=0.0035,
    far_off=0.008,
    beside=0.0015,
    moving=2e-4,
)
LAPTOP = Task(
    TARGETS["laptop"], "lid", tolerance=math.radians(2.0), good_enough=math.radians(1.2), far_off=math.radians(6.0),
    beside=math.radians(0.6), moving=1e-3,
)  # fmt: skip
FAUCET = Task(
    TARGETS["faucet"], "lever", tolerance=math.radians(3.0), good_enough=math.radians(0.7),
    far_off=math.radians(10.0), beside=math.radians(1.5), moving=2e-3, told_to=0.12,
)  # fmt: skip
TASKS = {task.name: task for task in (DRAWER, LAPTOP, FAUCET)}


def parse_point(text: str) -> Point:
    """``x,y,z`` in metres, base frame.

    Raises:
        UsageError: Not three finite numbers.
    """
    try:
        x, y, z = (float(one) for one in text.split(","))
    except ValueError:
        raise UsageError(
            f"--at {text!r} is not x,y,z in metres in the arm's base frame, as 0.55,0.02,0.25"
        ) from None
    if not all(map(math.isfinite, (x, y, z))):
        raise UsageError(f"--at {text} is not finite")
    return x, y, z
