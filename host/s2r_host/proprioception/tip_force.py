"""The force of the fingertip on what it touches, from joint torques less what the arm itself takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.proprioception.own_torques import OwnTorques
from s2r_host.proprioception.samples import Samples

WEAK_N = 50.0  # prior of each component: directions that no joint feels stay bounded


@dataclass(frozen=True, eq=False)
class TipForce:
    """Along one motion.

    Attributes:
        p: Where it acts, base frame [m], (n, 3).
        force_N: On what is touched, base frame [N], (n, 3).
        covariance: Of the force [N²], (n, 3, 3).
    """

    p: np.ndarray
    force_N: np.ndarray
    covariance: np.ndarray

    def along(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The force's components along vectors (n, 3), and their standard errors, (n,) each."""
        value = (self.force_N * directions).sum(axis=1)
        variance = np.einsum("ni,nij,nj->n", directions, self.covariance, directions)
        return value, np.sqrt(variance)


def tip_force(own: OwnTorques, samples: Samples, p: np.ndarray | None = None) -> TipForce:
    """Weighted least squares of Jᵀ F = τ − τ_own in every row: a joint counts by how well its torque is known.

    Args:
        own: What the arm itself takes.
        samples: The motion.
        p: Where the tool is touched in every row, base frame [m], (n, 3); None: at its tip.
    """
    dynamics = own.dynamics
    p = dynamics.tool_positions(samples.q) if p is None else p
    extra = samples.tau - own.along(samples)
    sigma = own.sigma(samples)
    forces, covariances = [], []
    for q, at, tau, spread in zip(samples.q, p, extra, sigma, strict=True):
        J = dynamics.point_jacobian(q, at).T / spread[:, None]
        covariance = np.linalg.inv(J.T @ J + np.eye(3) / WEAK_N**2)
        forces.append(covariance @ (J.T @ (tau / spread)))
        covariances.append(covariance)
    return TipForce(p, np.array(forces), np.array(covariances))
