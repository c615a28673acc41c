"""How far the truth may be from the believed object: intervals of its numbers, of its joint, of its place."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

Z90 = 1.645  # half a 90 % interval over the standard deviation
CHI90 = {2: 2.146, 3: 2.500}  # radius that holds 90 % of a normal distribution, over its deviation per axis


class DoubtError(ValueError):
    """An interval is none."""


@dataclass(frozen=True)
class Doubt:
    """What a plan should hold for. The file's object is among all that is believable; it need not be their middle.

    Attributes:
        friction: Lowest and highest factor on the friction between robot and object.
        damping: Of the joint's viscous damping.
        joint_friction: Of the joint's dry friction.
        shift_sigma_m: Standard deviation of the object's place, per axis.
        axis_angle_rad: 90 %: the joint's direction is within this angle of the file's.
        axis_offset_m: 90 %: a hinge's axis passes within this distance of the file's pivot.
        along: 90 %: the part stands within this further along its joint, or less far, than believed [m or rad]: the
            state's interval, and how thick it is where no camera saw its back.
    """

    friction: tuple[float, float] = (0.6, 1.4)
    damping: tuple[float, float] = (0.5, 1.5)
    joint_friction: tuple[float, float] = (0.5, 1.5)
    shift_sigma_m: float = 0.002
    axis_angle_rad: float = 0.0
    axis_offset_m: float = 0.0
    along: float = 0.0

    def __post_init__(self) -> None:
        for name in ("friction", "damping", "joint_friction"):
            low, high = getattr(self, name)
            if not 0.0 <= low <= high < float("inf"):
                raise DoubtError(
                    f"doubt about {name}: ({low:g}, {high:g}) is no interval of factors, 0 <= low <= high"
                )
        for name in ("shift_sigma_m", "axis_angle_rad", "axis_offset_m", "along"):
            if not 0.0 <= getattr(self, name) < float("inf"):
                raise DoubtError(
                    f"doubt {name} = {getattr(self, name):g} is not allowed: zero or more, and finite"
                )

    @property
    def about_joint(self) -> bool:
        """Whether the joint's axis or the part's place along it is in doubt."""
        return max(self.axis_angle_rad, self.axis_offset_m, self.along) > 0.0

    def scaled(self, share: float) -> Doubt:
        """A share of this doubt: of lengths and angles linear, of factors in their logarithm."""
        spans = {
            name: (getattr(self, name)[0] ** share, getattr(self, name)[1] ** share)
            for name in ("friction", "damping", "joint_friction")
        }
        lengths = {
            name: share * getattr(self, name)
            for name in ("shift_sigma_m", "axis_angle_rad", "axis_offset_m", "along")
        }
        return replace(self, **spans, **lengths)

    def as_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def factors(value: float, low: float, high: float) -> tuple[float, float]:
    """The interval of a positive number as factors on its value.

    Raises:
        DoubtError: The value is not positive, or the interval is none.
    """
    if not value > 0.0 or not low <= high:
        raise DoubtError(f"{value:g} with the interval [{low:g}, {high:g}] cannot be told in factors")
    return max(low, 0.0) / value, high / value
