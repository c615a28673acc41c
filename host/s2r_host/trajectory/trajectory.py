"""A timed joint motion as knots of position, velocity and acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from s2r_host.errors import HostError
from s2r_host.trajectory import quintic
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import RefusedError


class TrajectoryError(HostError, RefusedError):
    """A path that cannot be timed within the arm's limits; the text says which one and where."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Knots with quintic segments between them: position, velocity and acceleration are continuous.

    Attributes:
        t: Times [s], (n,), growing, from 0.
        q, dq, ddq: Position [rad], velocity [rad/s], acceleration [rad/s²] at the knots, (n, dof).
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray

    @property
    def duration_s(self) -> float:
        """Time from the first to the last knot."""
        return float(self.t[-1])

    @cached_property
    def segments(self) -> np.ndarray:
        """Polynomials of the segments, (n - 1, dof, 6); see :mod:`s2r_host.trajectory.quintic`."""
        return quintic.coefficients(self.t, self.q, self.dq, self.ddq)

    def sample(self, t: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration at times, each (dof,) or (m, dof); constant outside [0, duration]."""
        times = np.clip(np.asarray(t, dtype=float), 0.0, self.t[-1])
        index = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        T = (self.t[index + 1] - self.t[index])[..., None]
        u = (times - self.t[index])[..., None] / T
        c = self.segments[index]
        return (
            quintic.evaluate(c, u),
            quintic.evaluate(quintic.derivative(c, 1), u) / T,
            quintic.evaluate(quintic.derivative(c, 2), u) / T**2,
        )

    def stretched(self, factor: float) -> Trajectory:
        """The same path, ``factor`` times slower."""
        return Trajectory(self.t * factor, self.q, self.dq / factor, self.ddq / factor**2)

    def peak(self, order: int) -> np.ndarray:
        """Largest magnitude per joint between the knots too, (dof,): order 1 velocity, 2 acceleration, 3 jerk."""
        T = np.diff(self.t)[:, None, None]
        low, high = quintic.bounds_over(quintic.derivative(self.segments, order) / T**order)
        return np.maximum(np.abs(low), np.abs(high))

    def range(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest position per joint, between the knots too, two (dof,) [rad]."""
        return quintic.bounds_over(self.segments)


def check_positions(trajectory: Trajectory, arm: ArmDescription) -> None:
    """Refuse a trajectory that leaves the position limits, at a knot or between.

    Raises:
        TrajectoryError: Names the joint, the value and the limit.
    """
    low, high = trajectory.range()
    for i, name in enumerate(arm.joint_names):
        q_min, q_max = arm.limits.q_min[i], arm.limits.q_max[i]
        for value in (low[i], high[i]):
            if not q_min <= value <= q_max:
                raise TrajectoryError(
                    f"joint {name!r} (index {i}): the path goes to {value:.4f} rad, outside "
                    f"[{q_min:.4f}, {q_max:.4f}] rad"
                )
