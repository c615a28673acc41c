"""What a run is about: the kind of object, the unit and sign of its joint, and how well it has to be moved."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from s2r_protocol.exits import UsageError

if TYPE_CHECKING:  # a target is refused before the seconds that perception takes to load
    from s2r_host.perception.motion import JointType

Point = tuple[float, float, float]
"""x, y, z [m], base frame."""


@dataclass(frozen=True)
class Unit:
    """A unit people read: its name and how many of them make one metre or radian."""

    name: str
    factor: float

    def show(self, value: float, digits: int = 2) -> str:
        """A signed value [m or rad] in this unit."""
        return f"{self.factor * value:+.{digits}f}{self.name if self.name == '°' else ' ' + self.name}"


MILLIMETRE = Unit("mm", 1e3)
DEGREE = Unit("°", math.degrees(1.0))


@dataclass(frozen=True)
class Task:
    """A kind of object that ``s2r run`` can move. Joint values: 0 = as found in the first view.

    Attributes:
        name: On the command line.
        joint_type: Of its joint.
        part: The moving part, for sentences.
        positive: Where positive joint values lead, for sentences.
        unit: For people; computations are in m and rad.
        limits: Targets that may be asked for [m or rad].
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

    name: str
    joint_type: JointType
    part: str
    positive: str
    unit: Unit
    limits: tuple[float, float]
    tolerance: float
    good_enough: float
    far_off: float
    beside: float
    moving: float
    told_to: float = 0.5

    def check(self, target: float, option: str = "--target") -> None:
        """Raises UsageError, which names the option, when a target cannot be meant."""
        low, high = self.limits
        if not low <= target <= high:
            raise UsageError(
                f"{option} {self.unit.show(target)} is outside [{self.unit.show(low, 0)}, {self.unit.show(high, 0)}] "
                f"of a {self.name}; 0 is as found in the first view, + is {self.positive}"
            )


DRAWER = Task(
    "drawer", "prismatic", "drawer", "out of the cabinet", MILLIMETRE, (-0.5, 0.6),
    tolerance=0.005, good_enough=0.0035, far_off=0.008, beside=0.0015, moving=2e-4,
)  # fmt: skip
LAPTOP = Task(
    "laptop", "revolute", "lid", "opening", DEGREE, (-math.pi, math.pi),
    tolerance=math.radians(2.0), good_enough=math.radians(1.2), far_off=math.radians(6.0),
    beside=math.radians(0.6), moving=1e-3,
)  # fmt: skip
FAUCET = Task(
    "faucet", "revolute", "lever", "counter-clockwise, or towards the arm", DEGREE, (-math.pi, math.pi),
    tolerance=math.radians(3.0), good_enough=math.radians(0.7), far_off=math.radians(10.0),
    beside=math.radians(1.5), moving=2e-3, told_to=0.12,
)  # fmt: skip
TASKS = {task.name: task for task in (DRAWER, LAPTOP, FAUCET)}

_SUFFIXES = {"mm": ("prismatic", 1e-3), "m": ("prismatic", 1.0), "deg": ("revolute", math.radians(1.0)),
             "°": ("revolute", math.radians(1.0)), "rad": ("revolute", 1.0)}  # fmt: skip


def parse_target(text: str, task: Task, option: str = "--target") -> float:
    """A target from the command line: a number with a unit (``150mm``, ``-30deg``), or in m or rad without one.

    Returns:
        [m or rad].

    Raises:
        UsageError: Not a number, the unit of another kind of joint, or outside what the task allows.
    """
    number, factor = text.strip(), 1.0
    for suffix in sorted(_SUFFIXES, key=len, reverse=True):
        if number.endswith(suffix):
            joint_type, factor = _SUFFIXES[suffix]
            if joint_type != task.joint_type:
                raise UsageError(f"{option} {text}: the joint of a {task.name} is not measured in {suffix}")
            number = number[: -len(suffix)]
            break
    try:
        target = float(number) * factor
    except ValueError:
        units = " or ".join(suffix for suffix, (kind, _) in _SUFFIXES.items() if kind == task.joint_type)
        raise UsageError(f"{option} {text!r} is not a number, with or without a unit ({units})") from None
    if not math.isfinite(target):
        raise UsageError(f"{option} {text} is not finite")
    task.check(target, option)
    return target


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
