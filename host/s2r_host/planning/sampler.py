"""What the planner asks of a sampler of action sequences, so that others can take the place of iCEM in comparisons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from s2r_host.planning.icem import Icem
from s2r_host.planning.settings import PlanSettings, Stage


class Sampler(Protocol):
    """Sequences of joint increments, (horizon, dof), rewards to be maximised. The order of calls is iCEM's."""

    @property
    def iterations(self) -> int:
        """Rounds of sampling per control step."""
        ...

    @property
    def horizon(self) -> int:
        """Control steps looked ahead."""
        ...

    def capacity(self, proposals: int) -> int:
        """Most sequences that one call of ``sample`` gives when so many are proposed."""
        ...

    def begin(self) -> None:
        """Start a control step."""
        ...

    def sample(self, proposals: np.ndarray | None = None) -> np.ndarray:
        """Sequences to evaluate now, (samples, horizon, dof); ``proposals`` may join them."""
        ...

    def update(self, samples: np.ndarray, rewards: np.ndarray) -> None:
        """Learn the rewards, (samples,), of what ``sample`` gave."""
        ...

    def ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """Sequences to try in the world, best first, (n, horizon, dof), and their rewards, (n,)."""
        ...

    def advance(self) -> None:
        """Go on by one control step."""
        ...

    def forget(self) -> None:
        """Drop what was learned; the randomness goes on."""
        ...


SamplerFactory = Callable[[PlanSettings, Stage, int, np.random.Generator], Sampler]
"""Makes the sampler of one attempt: settings, stage of the cascade, number of joints, the only source of chance."""


def icem_sampler(settings: PlanSettings, stage: Stage, dof: int, rng: np.random.Generator) -> Sampler:
    """iCEM with the stage's population and horizon; the elites scale along."""
    scale = stage.population / settings.icem.population
    elites = max(2, round(settings.icem.elites * scale))
    horizon = stage.horizon or settings.icem.horizon
    icem = replace(settings.icem, population=stage.population, elites=elites, horizon=horizon)
    return Icem(icem, np.full(dof, settings.action_max_rad), rng)
