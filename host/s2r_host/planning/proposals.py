"""Action sequences offered to the sampler: along a route of joint postures, at a few speeds.

They are samples like any other: the rollouts judge them, and where the route is blocked the noise finds the way.
"""

from __future__ import annotations

import itertools

import numpy as np


class Route:
    """A polyline through joint postures, cut into pieces of one action's length."""

    def __init__(self, waypoints: np.ndarray, action_max: float) -> None:
        """Args: ``waypoints`` (m, dof) [rad], the first is the start pose; ``action_max`` [rad], the piece length."""
        pieces = [waypoints[:1]]
        for a, b in itertools.pairwise(waypoints):
            count = max(1, int(np.ceil(np.abs(b - a).max() / action_max)))
            pieces.append(a + (np.arange(1, count + 1) / count)[:, None] * (b - a))
        self.points = np.concatenate(pieces)
        self._action_max = action_max

    def proposals(self, target: np.ndarray, horizon: int, speeds: tuple[float, ...]) -> np.ndarray:
        """Sequences from a joint target on along the route, (speeds, horizon, dof), at speeds of at most 1.

        Each heads for the route's points ahead of the nearest one; an action never exceeds its bound.
        """
        if not speeds:
            return np.zeros((0, horizon, len(target)))
        nearest = int(((self.points - target) ** 2).sum(axis=1).argmin())
        last = len(self.points) - 1
        ahead = np.minimum(nearest + np.array(speeds)[:, None] * np.arange(1, horizon + 1), last)
        left = np.minimum(ahead.astype(int), max(last - 1, 0))
        right = np.minimum(left + 1, last)
        share = (ahead - left)[..., None]
        goals = (1.0 - share) * self.points[left] + share * self.points[right]
        # Nothing gets further than the largest actions lead; from there on the route's own pieces are short enough.
        farthest = self._action_max * np.arange(1.0, horizon + 1.0)[:, None]
        actions = np.clip(goals - target, -farthest, farthest)
        actions[:, 1:] -= actions[:, :-1].copy()
        return actions
