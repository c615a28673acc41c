"""The force of the fingertip on what it touches, from joint torques less what the arm itself takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.proprioception.own_torques import OwnTorques
from s2r_host.proprioception.samples import Samples

WEAK_N = 50.0  # prior of each component: directions that no joint feels stay bounded
# How far the place touched is off: a fingertip is flat, a part's surface known to millimetres.
PLACE_M = 0.004
LEAST_N = 1.0  # a force smaller than that has a moment all the same: torques are known to hundredths


@dataclass(frozen=True, eq=False)
class TipForce:
    """Along one motion.

    Attributes:
        p: Where it is believed to act, base frame [m], (n, 3).
        force_N: On what is touched, base frame [N], (n, 3).
        moment_Nm: About ``p``, base frame [N·m], (n, 3): of a force that acts a little beside it.
        covariance: Of force and moment, (n, 6, 6).
        misfit: Squared deviation of the joint torques from those of one force at about ``p``, per degree of freedom
            left, (n,): about one; far above where the arm touches something else as well.
    """

    p: np.ndarray
    force_N: np.ndarray
    moment_Nm: np.ndarray
    covariance: np.ndarray
    misfit: np.ndarray

    def part(self, rows: np.ndarray) -> TipForce:
        """Some of the rows."""
        return TipForce(
            self.p[rows], self.force_N[rows], self.moment_Nm[rows], self.covariance[rows], self.misfit[rows]
        )

    def along(
        self, directions: np.ndarray, turning: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """What force and moment do along a motion, and its standard errors, (n,) each [N, or N·m per radian].

        Args:
            directions: Motion of ``p``, (n, 3).
            turning: Turn of what is touched, (3,); None: the moment does not count.
        """
        turns = np.zeros_like(directions) if turning is None else np.broadcast_to(turning, directions.shape)
        motion = np.concatenate([directions, turns], axis=1)
        value = (np.concatenate([self.force_N, self.moment_Nm], axis=1) * motion).sum(axis=1)
        variance = np.einsum("ni,nij,nj->n", motion, self.covariance, motion)
        return value, np.sqrt(variance)


def tip_force(own: OwnTorques, samples: Samples, p: np.ndarray | None = None) -> TipForce:
    """Weighted least squares of Jᵀ (F, M) = τ − τ_own in every row: a joint counts by how well its torque is known.

    The moment is that of a force that acts within ``PLACE_M`` of where it is believed to: a prior of its own.

    Args:
        own: What the arm itself takes.
        samples: The motion.
        p: Where the tool is touched in every row, base frame [m], (n, 3); None: at its tip.
    """
    dynamics = own.dynamics
    p = dynamics.tool_positions(samples.q) if p is None else p
    extra = samples.tau - own.along(samples)
    sigma = own.sigma(samples)
    found = [
        _wrench(dynamics.point_jacobian(q, at).T / spread[:, None], tau / spread)
        for q, at, tau, spread in zip(samples.q, p, extra, sigma, strict=True)
    ]
    wrenches = np.array([one.value for one in found]).reshape(-1, 6)
    return TipForce(
        p,
        wrenches[:, :3],
        wrenches[:, 3:],
        np.array([one.covariance for one in found]),
        np.array([one.misfit for one in found]),
    )


@dataclass(frozen=True, eq=False)
class _Wrench:
    """Force and moment (6,), their covariance (6, 6), misfit per degree of freedom left."""

    value: np.ndarray
    covariance: np.ndarray
    misfit: float


def _wrench(A: np.ndarray, y: np.ndarray) -> _Wrench:
    """Least squares of A x = y, both in standard errors of the joint torques, (dof, 6) and (dof,)."""
    first = _fitted(A, y, LEAST_N)  # how far a moment may go is known with the force
    x, covariance, prior = _fitted(A, y, max(LEAST_N, float(np.linalg.norm(first[0][:3]))))
    off, beside = y - A @ x, x[3:] / prior[3:]
    return _Wrench(x, covariance, float(off @ off + beside @ beside) / max(len(y) - 3, 1))


def _fitted(A: np.ndarray, y: np.ndarray, force_N: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wrench with the prior of a moment that goes with a force of this size, its covariance, and that prior."""
    prior = np.array([WEAK_N] * 3 + [PLACE_M * force_N] * 3)
    covariance = np.linalg.inv(A.T @ A + np.diag(prior**-2.0))
    return covariance @ (A.T @ y), covariance, prior
