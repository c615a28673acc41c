"""Joint values as people write them (``150mm``, ``-30deg``), and what may be asked of which kind of object.

Host and demo read the same options, so that both refuse a slip of the hand before anything is started.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from s2r_protocol.exits import UsageError

JointType = Literal["prismatic", "revolute"]


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

_SUFFIXES: dict[str, tuple[JointType, float]] = {
    "mm": ("prismatic", 1e-3),
    "m": ("prismatic", 1.0),
    "deg": ("revolute", math.radians(1.0)),
    "°": ("revolute", math.radians(1.0)),
    "rad": ("revolute", 1.0),
}


def units_of(joint_type: JointType | None) -> str:
    """The suffixes of one kind of joint, or of both, for sentences."""
    return " or ".join(suffix for suffix, (kind, _) in _SUFFIXES.items() if joint_type in (None, kind))


def read_joint_value(
    text: str, option: str, wanted: JointType | None = None
) -> tuple[float, JointType | None]:
    """A joint value from the command line: a number with a unit, or in m or rad without one.

    Args:
        text: As it was written.
        option: For sentences.
        wanted: The kind of joint, where it is known: whose units a refusal names.

    Returns:
        Value [m or rad], and the kind of joint its unit belongs to, None without a unit.

    Raises:
        UsageError: Not a finite number.
    """
    number, factor, joint_type = text.strip(), 1.0, None
    for suffix in sorted(_SUFFIXES, key=len, reverse=True):
        if number.endswith(suffix):
            joint_type, factor = _SUFFIXES[suffix]
            number = number[: -len(suffix)]
            break
    try:
        value = float(number) * factor
    except ValueError:
        raise UsageError(
            f"{option} {text!r} is not a number, with or without a unit ({units_of(wanted)})"
        ) from None
    if not math.isfinite(value):
        raise UsageError(f"{option} {text} is not finite")
    return value, joint_type


@dataclass(frozen=True)
class Targets:
    """What may be asked of a kind of object. Joint values: 0 = as found in the first view.

    Attributes:
        kind: Of object, for sentences.
        joint_type: Of its joint.
        unit: For people; computations are in m and rad.
        low, high: Targets that can be meant [m or rad].
        positive: Where positive joint values lead, for sentences.
    """

    kind: str
    joint_type: JointType
    unit: Unit
    low: float
    high: float
    positive: str

    def check(self, target: float, option: str = "--target") -> None:
        """Raises UsageError, which names the option, when a target cannot be meant."""
        if not self.low <= target <= self.high:
            low, high = self.unit.show(self.low, 0), self.unit.show(self.high, 0)
            raise UsageError(
                f"{option} {self.unit.show(target)} is outside [{low}, {high}] of a {self.kind}; 0 is as found in the "
                f"first view, + is {self.positive}"
            )

    def read(self, text: str, option: str = "--target") -> float:
        """A target from the command line [m or rad].

        Raises:
            UsageError: Not a finite number, the unit of another kind of joint, or outside what can be meant.
        """
        target, joint_type = read_joint_value(text, option, self.joint_type)
        if joint_type not in (None, self.joint_type):
            raise UsageError(
                f"{option} {text}: the joint of a {self.kind} is measured in {units_of(self.joint_type)}"
            )
        self.check(target, option)
        return target


TARGETS = {
    targets.kind: targets
    for targets in (
        Targets("drawer", "prismatic", MILLIMETRE, -0.5, 0.6, "out of the cabinet"),
        Targets("laptop", "revolute", DEGREE, -math.pi, math.pi, "opening"),
        Targets("faucet", "revolute", DEGREE, -math.pi, math.pi, "counter-clockwise, or towards the arm"),
    )
}
