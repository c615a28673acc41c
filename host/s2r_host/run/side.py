"""Where the pushed side of a part really is, told by how far beside the foreseen place motions left the part.

A side that lies a millimetre further back than modelled leaves the part that much further on: half a degree where the
fingertip pushed 110 mm from a hinge, one degree where it pushed at 60, and by other amounts at other heights where the
side stands askew. A small rigid motion of the side (a shift and a turn about the part's middle) explains all of them
at once. Its mean under a Gaussian prior is linear regression (Bishop, Pattern Recognition and Machine Learning, 3.3),
with errors that all looks of one kind share and one of each motion; motions that went another way are weighed down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

SHARED = 0.5  # of a look's variance is the same in all looks of one kind: the same faces from the same side
SCATTER = 0.15  # of what motions usually end beside: by so much like ones differ among themselves
OUTLYING = 1.5  # scatters from which on a motion counts less
ROUNDS = 6
TURN_PER_M = 6.0  # doubt about a side's turn [rad] per doubt about its place [m]: one part in 170 mm


@dataclass(frozen=True, eq=False)
class Touch:
    """One motion that pushed the side.

    Attributes:
        offset: How much further than foreseen it left the part (negative: less far) [m or rad].
        sigma: Standard error of the look afterwards [m or rad].
        joint: Error that the joint, as far as it is known, makes in all looks thereabouts [m or rad].
        columns: What ``offset`` becomes per unit of each number that says where the side is, (k,).
    """

    offset: float
    sigma: float
    joint: float
    columns: np.ndarray


def hinge_columns(p: np.ndarray, middle: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """How a small motion of a hinge's side moves the end of a motion that pushed at one place.

    Args:
        p: The place, (3,) [m].
        middle: Of the part, about which the side is turned, (3,) [m].
        velocity: Of the place per radian of the joint, (3,) [m/rad].

    Returns:
        Joint value per turn (3,) [rad/rad] and shift (3,) [rad/m] of the side against the motion, (6,).
    """
    radius = float(np.linalg.norm(velocity))
    along = velocity / radius
    return np.concatenate([np.cross(p - middle, along), along]) / radius


def where(touches: Sequence[Touch], beside: float, usual: np.ndarray) -> np.ndarray:
    """Where the side is, against where the model has it.

    Args:
        touches: Motions that pushed it, at least one.
        beside: How far beside where they are foreseen motions usually leave the part [m or rad].
        usual: Standard deviations of what is sought, (k,); see :func:`hinge_doubts`.

    Returns:
        Mean of what is sought, (k,); zero where the looks tell nothing.
    """
    seen = [touch for touch in touches if np.isfinite(touch.sigma)]
    if not seen:
        return np.zeros(len(usual))
    A = np.stack([touch.columns for touch in seen])
    offset = np.array([touch.offset for touch in seen])
    sigma, joint = np.array([touch.sigma for touch in seen]), np.array([touch.joint for touch in seen])
    prior, told_apart = np.diag(usual**2), len(seen) > 2
    shared = SHARED * np.outer(sigma, sigma) + np.outer(joint, joint)
    own = np.sqrt((1.0 - SHARED) * sigma**2 + (SCATTER * beside) ** 2)
    left = offset - np.median(offset)
    found = np.zeros(len(usual))
    for _ in range(ROUNDS):
        outlying = np.maximum(np.abs(left) / own - OUTLYING, 0.0) * told_apart
        noise = shared + np.diag(own**2 * (1.0 + outlying**2))
        found = prior @ A.T @ np.linalg.solve(A @ prior @ A.T + noise, offset)
        left = offset - A @ found
    return found


def hinge_doubts(beside: float, radius_m: float) -> np.ndarray:
    """Standard deviations of turn and shift of a hinge's side where it is usually pushed so far from the axis, (6,)."""
    shift = beside * radius_m
    return np.repeat([TURN_PER_M * shift, shift], 3)


def transform(found: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """X (4, 4) that moves the modelled side against the motion to where it was found, (6,) about ``middle`` (3,)."""
    turn, shift = -found[:3], -found[3:]
    X = np.eye(4)
    X[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    X[:3, 3] = middle + shift - X[:3, :3] @ middle
    return X
