"""Judo's cross-entropy method in the place of our sampler: its own class, unchanged, on our rollouts and reward.

Judo (Robotics and AI Institute, package judo-rai 0.0.6, MIT licence) ships the optimizer that is used here; its
controller is followed call by call: nominal knots shifted in time by linear interpolation, sampled, clipped,
interpolated over the horizon, rolled out, updated; the nominal is what gets executed. It is not a dependency:
``pip install --no-deps judo-rai==0.0.6`` and ``pip install viser`` make it importable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import interp1d

from s2r_host.planning.sampler import Sampler, SamplerFactory
from s2r_host.planning.settings import PlanSettings, Stage
from s2r_protocol.exits import NotReadyError


@dataclass(frozen=True)
class JudoSettings:
    """Judo's own parameters, knots in shares of the largest joint increment.

    Attributes:
        nodes: Knots over the horizon.
        elites: Samples that the next distribution is fitted to.
        sigma_min, sigma_max: Its deviation is clipped to these.
        iterations: Optimizer iterations per control step.
    """

    nodes: int = 3
    elites: int = 10
    sigma_min: float = 0.05
    sigma_max: float = 0.3
    iterations: int = 2


def judo_sampler(judo: JudoSettings) -> SamplerFactory:
    """A factory of Judo's sampler; population and horizon are the stage's."""

    def make(settings: PlanSettings, stage: Stage, dof: int, rng: np.random.Generator) -> Sampler:
        icem = replace(settings.icem, horizon=stage.horizon or settings.icem.horizon)
        return JudoCem(judo, replace(settings, icem=icem), stage.population, dof, rng)

    return make


class JudoCem:
    """Judo's optimizer behind the planner's sampler interface."""

    def __init__(
        self, judo: JudoSettings, settings: PlanSettings, population: int, dof: int, rng: np.random.Generator
    ) -> None:
        """Args: Judo's and the planner's settings; rollouts per iteration; joints; source of chance.

        Raises:
            NotReadyError: Judo is not installed.
        """
        self._optimizer = _optimizer(judo, population, dof)
        self.iterations, self.horizon = judo.iterations, settings.icem.horizon
        self._population = population
        self._action_max = settings.action_max_rad
        self._times = np.linspace(0.0, self.horizon - 1.0, judo.nodes)  # in control steps
        self._nominal = np.zeros((judo.nodes, dof))
        self._knots = self._nominal[None]
        self._best = -np.inf
        # Judo draws from NumPy's global generator.
        np.random.seed(int(rng.integers(2**32)))

    def capacity(self, proposals: int) -> int:
        """Its rollouts per iteration; Judo takes no proposals."""
        del proposals
        return self._population

    def begin(self) -> None:
        """Judo never widens its deviation again; there is nothing to reset."""

    def sample(self, proposals: np.ndarray | None = None) -> np.ndarray:
        """Sequences of joint increments, (rollouts, horizon, dof), the nominal first."""
        del proposals
        self._knots = np.clip(self._optimizer.sample_control_knots(self._nominal), -1.0, 1.0)
        return self._spline(self._knots, np.arange(self.horizon)) * self._action_max

    def update(self, samples: np.ndarray, rewards: np.ndarray) -> None:
        """Let Judo fit its nominal to the best."""
        del samples
        self._best = float(rewards.max())
        self._nominal = self._optimizer.update_nominal_knots(self._knots, rewards)

    def ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """The nominal alone: what Judo executes."""
        sequence = self._spline(self._nominal[None], np.arange(self.horizon)) * self._action_max
        return sequence, np.array([self._best])

    def advance(self) -> None:
        """Shift the nominal by one control step."""
        self._nominal = self._spline(self._nominal, self._times + 1.0)

    def forget(self) -> None:
        """Back to a nominal of standing still."""
        self._nominal = np.zeros_like(self._nominal)

    def _spline(self, knots: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Linear interpolation, held beyond the last knot, as Judo's ``make_spline``."""
        ends: Any = (knots[..., 0, :], knots[..., -1, :])
        return interp1d(self._times, knots, axis=-2, fill_value=ends, bounds_error=False)(times)


def require_judo() -> tuple[Any, Any]:
    """Judo's optimizer and the class of its settings.

    Raises:
        NotReadyError: Judo is not installed.
    """
    try:
        from judo.optimizers.cem import (  # pyright: ignore[reportMissingImports]
            CrossEntropyMethod,
            CrossEntropyMethodConfig,
        )
    except ImportError as error:
        raise NotReadyError(
            f"planner 'judo' needs the package judo-rai ({error}); install it with "
            "'pip install viser && pip install --no-deps judo-rai==0.0.6'"
        ) from error
    return CrossEntropyMethod, CrossEntropyMethodConfig


def _optimizer(judo: JudoSettings, population: int, dof: int) -> Any:
    optimizer, settings = require_judo()
    config = settings(
        num_rollouts=population,
        num_nodes=judo.nodes,
        sigma_min=judo.sigma_min,
        sigma_max=judo.sigma_max,
        num_elites=judo.elites,
    )
    return optimizer(config, dof)
