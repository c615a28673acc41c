"""Where the pushed side of a part really is, told by how far beside the foreseen place motions left the part.

A side that lies a millimetre further back than modelled leaves the part that much further on: half a degree where the
fingertip pushed 110 mm from a hinge, one degree where it pushed at 60, and by other amounts at other heights where the
side stands askew. A small rigid motion of the side (a shift and a turn about the part's middle) explains all of them
at once. Its mean under a Gaussian prior is linear regression (Bishop, Pattern Recognition and Machine Learning, 3.3),
with errors that all looks of one kind share and one of each motion; motions that went another way are weighed down.
What one motion tells is believed by half until another one agrees.
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
ROLL_RAD = 0.15  # of a lever about its own line: it is too thin for a camera to tell how it lies
SLIPPED = (
    2.0  # times what motions usually end beside: so far off is one that slipped over an edge, hardly a side
)


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


def where(touches: Sequence[Touch], beside: float, prior: np.ndarray) -> np.ndarray:
    """Where the side is, against where the model has it.

    Args:
        touches: Motions that pushed it, at least one.
        beside: How far beside where they are foreseen motions usually leave the part [m or rad].
        prior: Covariance of what is sought, (k, k); see :func:`hinge_doubts`.

    Returns:
        Mean of what is sought, (k,); zero where the looks tell nothing.
    """
    seen = [touch for touch in touches if np.isfinite(touch.sigma)]
    if not seen:
        return np.zeros(len(prior))
    A = np.stack([touch.columns for touch in seen])
    offset = np.array([touch.offset for touch in seen])
    sigma, joint = np.array([touch.sigma for touch in seen]), np.array([touch.joint for touch in seen])
    told_apart = len(seen) > 2
    shared = SHARED * np.outer(sigma, sigma) + np.outer(joint, joint)
    own = np.sqrt((1.0 - SHARED) * sigma**2 + (SCATTER * beside) ** 2)
    if len(seen) == 1:  # one motion alone may have gone another way: it teaches half
        own = np.hypot(own, np.sqrt(A @ prior @ A.T)[0])
    left = offset - np.median(offset)
    found = np.zeros(len(prior))
    for _ in range(ROUNDS):
        outlying = np.maximum(np.abs(left) / own - OUTLYING, 0.0) * told_apart
        noise = shared + np.diag(own**2 * (1.0 + outlying**2))
        found = prior @ A.T @ np.linalg.solve(A @ prior @ A.T + noise, offset)
        left = offset - A @ found
    return found


def hinge_doubts(beside: float, radius_m: float, along: np.ndarray | None = None) -> np.ndarray:
    """Covariance of turn and shift of a hinge's side, (6, 6).

    Args:
        beside: How far beside where they are foreseen motions usually leave the part [rad].
        radius_m: From the axis to where it is usually pushed.
        along: Unit vector along a lever's line, (3,); None for what is no lever.
    """
    shift = beside * radius_m
    prior = np.diag(np.repeat([TURN_PER_M * shift, shift], 3) ** 2)
    if along is not None:
        prior[:3, :3] += ROLL_RAD**2 * np.outer(along, along)
    return prior


def none_slipped(touches: Sequence[Touch], beside: float) -> list[Touch]:
    """Those that did not end too far off to tell of a hinge's side, where there are too few to tell an outlier.

    From one that slipped the next would learn to miss by as much the other way. Two that agree are believed.
    """
    offsets = [touch.offset for touch in touches]
    if len(offsets) > 2 or (len(offsets) == 2 and abs(offsets[0] - offsets[1]) < beside):
        return list(touches)
    return [touch for touch in touches if abs(touch.offset) < SLIPPED * beside]


def transform(found: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """X (4, 4) that moves the modelled side against the motion to where it was found, (6,) about ``middle`` (3,)."""
    turn, shift = -found[:3], -found[3:]
    X = np.eye(4)
    X[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    X[:3, 3] = middle + shift - X[:3, :3] @ middle
    return X
