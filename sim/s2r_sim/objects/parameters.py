"""What the parameter sets of all objects have in common."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

Rgb = tuple[float, float, float]


class Parameters(BaseModel):
    """A frozen set of hidden parameters; unknown keys in a file are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def absent(value: object) -> bool:
    """Leaves a field out of a world file where it is None: files written before the field keep their commitment."""
    return value is None


class Standing(Parameters):
    """An object on the table.

    Attributes:
        x_m, y_m, yaw_rad: Object frame in the arm base frame; at yaw 0 its x axis, the front, looks at the arm.
        q_start: Joint value as found [m or rad].
        q_max: Joint values run from 0 to this [m or rad].
        coulomb: Dry friction of the joint [N or N·m].
        damping: Viscous friction of the joint [N·s/m or N·m·s/rad].
        mass_kg: Of the moving part.
        friction: Sliding friction of the visible surfaces.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    q_start: float = Field(ge=0.0)
    q_max: float = Field(gt=0.0)
    coulomb: float = Field(ge=0.0)
    damping: float = Field(ge=0.0)
    mass_kg: float = Field(gt=0.0)
    friction: float = Field(ge=0.0)

    @model_validator(mode="after")
    def _found_between_its_stops(self) -> Standing:
        if self.q_start > self.q_max:
            raise ValueError(f"q_start {self.q_start:g} is beyond q_max {self.q_max:g}")
        return self


def uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """One draw, rounded to 1e-6 so that a world file shows exactly what is simulated."""
    return round(float(rng.uniform(low, high)), 6)


def pick(rng: np.random.Generator, options: Sequence[str]) -> str:
    """One of the options, all equally likely."""
    return options[int(rng.integers(len(options)))]


def tinted(rng: np.random.Generator, low: float, high: float) -> Rgb:
    """A colour of brightness ``low`` to ``high``, slightly tinted."""
    shade = rng.uniform(low, high)
    r, g, b = np.clip(shade * rng.uniform(0.85, 1.1, 3), 0.02, 0.98)
    return round(float(r), 6), round(float(g), 6), round(float(b), 6)
