"""iCEM: the cross-entropy method with coloured noise and memory. Knows nothing about robots or physics.

Use: ``begin()``, then for every iteration ``sample()`` and ``update(samples, rewards)``, then ``ranked()``
for the sequences worth executing, then ``advance()`` to the next control step.
Source: Pinneri et al., Sample-efficient Cross-Entropy Method for Real-time Planning, CoRL 2020.
"""

from __future__ import annotations

import numpy as np

from s2r_host.planning.noise import coloured_noise
from s2r_host.planning.settings import IcemSettings


class Icem:
    """Sampler of action sequences within a symmetric box, shape (horizon, dof), rewards to be maximised."""

    def __init__(self, settings: IcemSettings, action_max: np.ndarray, rng: np.random.Generator) -> None:
        """Args: settings; ``action_max`` (dof,), half range per action; ``rng``, the only source of chance."""
        self.settings = settings
        self._rng = rng
        self._shape = (settings.horizon, len(action_max))
        self._high = np.tile(np.asarray(action_max, dtype=float), (settings.horizon, 1))
        self._low = -self._high
        self._mean = np.zeros(self._shape)
        self._sigma = np.zeros(self._shape)
        self._elites = np.zeros((0, *self._shape))
        self._inherited = np.zeros((0, *self._shape))
        self._pool: list[tuple[np.ndarray, np.ndarray]] = []
        self._iteration = 0

    @property
    def iterations(self) -> int:
        """Cross-entropy iterations per control step."""
        return self.settings.iterations

    @property
    def horizon(self) -> int:
        """Control steps looked ahead."""
        return self.settings.horizon

    def capacity(self, proposals: int) -> int:
        """Most sequences in one iteration: fresh ones, those inherited or kept, proposals, the mean."""
        return self.settings.population + self.settings.elites + proposals + 1

    def begin(self) -> None:
        """Start a control step: widen the distribution again; forget this step's samples."""
        self._sigma = self.settings.sigma * self._high
        if not self.settings.warm_start:
            self._mean = np.zeros(self._shape)
        self._elites = np.zeros((0, *self._shape))
        self._pool = []
        self._iteration = 0

    def population(self, iteration: int) -> int:
        """Fresh samples in an iteration, counted from 0: N decays, but never below twice the elites."""
        s = self.settings
        return min(s.population, max(int(s.population * s.decay**-iteration), 2 * s.elites))

    def sample(self, proposals: np.ndarray | None = None) -> np.ndarray:
        """Sequences to evaluate now, (samples, horizon, dof): fresh ones, carried elites, the mean.

        ``proposals``, (n, horizon, dof), join the first iteration.
        """
        s = self.settings
        count = self.population(self._iteration)
        noise = coloured_noise(self._rng, (count, *self._shape), s.noise_beta, s.knots)
        fresh = self._mean + self._sigma * noise
        groups = [fresh]
        if self._iteration == 0 and s.shift_elites:
            groups.append(self._inherited)
        if self._iteration == 0 and proposals is not None:
            groups.append(proposals)
        if self._iteration > 0 and s.keep_elites:
            groups.append(self._elites[: self._kept()])
        if self._iteration == s.iterations - 1 and s.mean_in_last:
            groups.append(self._mean[None])
        samples = np.concatenate(groups)
        np.maximum(samples, self._low, out=samples)
        return np.minimum(samples, self._high, out=samples)

    def update(self, samples: np.ndarray, rewards: np.ndarray) -> None:
        """Fit the distribution to the best samples.

        Args:
            samples: What ``sample()`` gave, (samples, horizon, dof).
            rewards: (samples,); a value that is not finite counts as the worst.
        """
        s = self.settings
        rewards = np.where(np.isfinite(rewards), rewards, -np.inf)
        # A stable sort: ties are decided by the order of sampling, the same on every machine.
        best = np.argsort(-rewards, kind="stable")[: s.elites]
        self._elites = samples[best]
        # As mean() and std() do it, number for number, in half of their time.
        mean = np.add.reduce(self._elites) / len(best)
        sigma = np.sqrt(np.add.reduce((self._elites - mean) ** 2) / len(best))
        self._mean = s.momentum * self._mean + (1.0 - s.momentum) * mean
        self._sigma = s.momentum * self._sigma + (1.0 - s.momentum) * sigma
        self._pool.append((self._elites, rewards[best]))
        self._iteration += 1

    def ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """Sequences to try in the world, best first, (n, horizon, dof), and their rewards, (n,)."""
        samples = np.concatenate([elites for elites, _ in self._pool])
        values = np.concatenate([v for _, v in self._pool])
        order = np.argsort(-values, kind="stable")
        samples, values = samples[order], values[order]
        if self.settings.execute_best:
            return samples, values
        mean = np.clip(self._mean, self._low, self._high)
        return np.concatenate([mean[None], samples]), np.concatenate([values[:1], values])

    def advance(self) -> None:
        """Go on by one control step: shift the mean and the best elites, repeating their last action."""
        self._mean = _shift(self._mean)
        self._inherited = np.array([_shift(e) for e in self._elites[: self._kept()]]).reshape(
            -1, *self._shape
        )

    def forget(self) -> None:
        """Drop mean and elites, as at the start; the randomness goes on."""
        self._mean = np.zeros(self._shape)
        self._inherited = np.zeros((0, *self._shape))

    def _kept(self) -> int:
        return min(len(self._elites), round(self.settings.keep_fraction * self.settings.elites))


def _shift(sequence: np.ndarray) -> np.ndarray:
    return np.concatenate([sequence[1:], sequence[-1:]])
