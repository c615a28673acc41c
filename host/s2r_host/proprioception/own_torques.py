"""What an arm's own links and gears take beyond its description, learnt from motions that touch nothing.

Joint torques become a force gauge only once the arm's own friction (tenths to newton metres, as much as an object's)
is known. The model is linear: changes of the links' ten inertial parameters each, and rotor inertia, dry and viscous
friction of each joint. Descriptions say nothing of rotors, and behind a gear they outweigh the links of a wrist. A weak
prior keeps what the motions do not show at its nominal value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from s2r_host.proprioception.samples import Samples
from s2r_host.trajectory.torque import InverseDynamics
from s2r_protocol.arms import ArmDescription

SIGN_RAD_S = 0.004  # dry friction turns over within about this speed
SLOW_RAD_S = 0.01  # below it the sign of dry friction is anybody's guess
NOISE_NM = 0.3  # of a row as if rows were independent: what is left over goes together for tenths of seconds
INERTIAL_SHARE, LEVER_M, GYRATION_M2 = (
    0.1,
    0.1,
    0.02,
)  # a link's mass, mass times lever, inertia may be off so much
ROTOR_KGM2 = 0.5  # tenths behind a gear of one to a hundred; none where torques are measured behind it
FRICTION_NM, FRICTION_NMS = 1.0, 1.0
LEAST_ROWS = 100


@dataclass(frozen=True, eq=False)
class OwnTorques:
    """Torques of an arm that touches nothing.

    Attributes:
        dynamics: Of the description.
        parameters: Changes of the links' inertial parameters (10 each: mass, mass times centre, inertia at the joint),
            rotor inertia [kg·m²], dry friction [N·m] and viscous friction [N·m·s/rad] of every joint, (13 dof,).
        covariance: Of the parameters, (13 dof, 13 dof): torques far from what the motions showed are guesses.
        rest: What is left over in motion, root mean square per joint [N·m], (dof,).
    """

    dynamics: InverseDynamics
    parameters: np.ndarray
    covariance: np.ndarray
    rest: np.ndarray

    @property
    def coulomb(self) -> np.ndarray:
        """Dry friction [N·m], (dof,)."""
        dof = len(self.rest)
        return self.parameters[-2 * dof : -dof]

    @property
    def viscous(self) -> np.ndarray:
        """Viscous friction [N·m·s/rad], (dof,)."""
        return self.parameters[-len(self.rest) :]

    def along(self, samples: Samples) -> np.ndarray:
        """Torques for a motion [N·m], (n, dof)."""
        nominal = self.dynamics.along(samples.q, samples.dq, samples.ddq)
        return nominal + _regressor(self.dynamics, samples) @ self.parameters

    def sigma(self, samples: Samples) -> np.ndarray:
        """How far they may be off [N·m], (n, dof): a joint at rest holds by dry friction of any size either way."""
        unsure = self.coulomb * (1.0 - np.abs(np.tanh(samples.dq / SIGN_RAD_S)))
        Y = _regressor(self.dynamics, samples)
        learnt = np.einsum("njk,kl,njl->nj", Y, self.covariance, Y)
        return np.sqrt(learnt + self.rest**2 + unsure**2)


def learn_own_torques(arm: ArmDescription, free: Sequence[Samples]) -> OwnTorques | None:
    """Fit the arm to motions that touched nothing; None when they are too short.

    Ridge regression in units of the prior: Gautier & Khalil's linear model of a manipulator's dynamics, with
    Pinocchio's regressor.

    Args:
        arm: Its description.
        free: Motions without contact; of one that was in contact from the first row on nothing is left.
    """
    free = [one for one in free if len(one)]
    if sum(len(one) for one in free) < LEAST_ROWS:
        return None
    dynamics = InverseDynamics(arm)
    A = np.concatenate([_regressor(dynamics, one) for one in free])
    b = np.concatenate([one.tau - dynamics.along(one.q, one.dq, one.ddq) for one in free])
    weight = (np.abs(np.concatenate([one.dq for one in free])) >= SLOW_RAD_S).astype(float)
    if (weight.sum(axis=0) < LEAST_ROWS).any():
        return None
    prior = _prior(dynamics)
    a = (A * weight[:, :, None] * prior).reshape(-1, len(prior)) / NOISE_NM
    spread = np.linalg.inv(a.T @ a + np.eye(len(prior)))
    x = spread @ (a.T @ (b * weight).ravel() / NOISE_NM) * prior
    left = (b - A @ x) * weight
    covariance = prior[:, None] * spread * prior
    return OwnTorques(dynamics, x, covariance, np.sqrt((left**2).sum(axis=0) / weight.sum(axis=0)))


def _regressor(dynamics: InverseDynamics, samples: Samples) -> np.ndarray:
    """Derivatives of the torques by the parameters, (n, dof, 13 dof)."""
    dof = samples.q.shape[1]
    drives = np.zeros((len(samples), dof, 3 * dof))
    joint = np.arange(dof)
    drives[:, joint, joint] = samples.ddq
    drives[:, joint, dof + joint] = np.tanh(samples.dq / SIGN_RAD_S)
    drives[:, joint, 2 * dof + joint] = samples.dq
    return np.concatenate([dynamics.regressor(samples.q, samples.dq, samples.ddq), drives], axis=2)


def _prior(dynamics: InverseDynamics) -> np.ndarray:
    """Standard deviations of the parameters before anything was measured, (13 dof,)."""
    masses = INERTIAL_SHARE * dynamics.link_masses
    links = np.outer(masses, [1.0, *[LEVER_M] * 3, *[GYRATION_M2] * 6]).ravel()
    dof = len(masses)
    drives = (ROTOR_KGM2, FRICTION_NM, FRICTION_NMS)
    return np.concatenate([links, np.repeat(drives, dof)])
