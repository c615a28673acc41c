"""What the parameter sets of all objects have in common."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict


class Parameters(BaseModel):
    """A frozen set of hidden parameters; unknown keys in a file are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """One draw, rounded to 1e-6 so that a world file shows exactly what is simulated."""
    return round(float(rng.uniform(low, high)), 6)
