"""The joint of an object from one view, without touching it: what the push network believes about part and motion.

This is the ablation "without interactive perception": a guess from looks. `estimate_joint` measures instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.affordance import Affordance
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.motion import JointType

Array = NDArray[np.floating]

BELIEVED = 0.5
FEWEST = 20
ROUNDS, SOFT_RAD = 8, np.radians(10)  # of reweighting; lines farther off than this count less
TURN_MARGIN_RAD = np.radians(2)  # a hinge has more freedom and must fit so much better than a slide


@dataclass(frozen=True, eq=False)
class GuessedJoint:
    """A joint without joint value and without sense.

    Attributes:
        joint_type: "revolute" or "prismatic".
        origin: A point on the axis [m], shape (3,).
        direction: Unit, shape (3,).
        misfit_rad: Median angle between the believed lines of motion and those of the joint.
    """

    joint_type: JointType
    origin: Array
    direction: Array
    misfit_rad: float


def guess_joint(belief: Affordance) -> GuessedJoint:
    """Fit the joint to the lines of motion of the points believed to belong to the part.

    Raises:
        AbstainError: Too few points are believed to.
    """
    chosen = belief.part > BELIEVED
    if chosen.sum() < FEWEST:
        raise AbstainError(
            f"only {int(chosen.sum())} points look like a part that moves, {FEWEST} are needed"
        )
    return fit_lines(belief.cloud.points[chosen], belief.line[chosen])


def fit_lines(points: Array, lines: Array) -> GuessedJoint:
    """The slide or hinge along whose motion the lines (n, 3) at the points (n, 3) lie best."""
    slide, turn = _robust(_slide, points, lines), _robust(_turn, points, lines)
    return turn if turn.misfit_rad + TURN_MARGIN_RAD < slide.misfit_rad else slide


Fit = Callable[[Array, Array, Array], tuple[JointType, Array, Array, Array]]


def _robust(fit: Fit, points: Array, lines: Array) -> GuessedJoint:
    """Fit again and again with less weight for what is off."""
    joint_type, origin, direction, off = fit(points, lines, np.ones(len(points)))
    for _ in range(ROUNDS):
        joint_type, origin, direction, off = fit(points, lines, 1.0 / (1.0 + (off / SOFT_RAD) ** 2))
    return GuessedJoint(joint_type, origin, direction, float(np.median(off)))


def _slide(points: Array, lines: Array, weight: Array) -> tuple[JointType, Array, Array, Array]:
    """Type, origin, direction and how far each line is off [rad]."""
    direction = np.linalg.eigh(np.einsum("n,ni,nj->ij", weight, lines, lines))[1][:, -1]
    return "prismatic", points.mean(axis=0), direction, _angle(lines, direction[None])


def _turn(points: Array, lines: Array, weight: Array) -> tuple[JointType, Array, Array, Array]:
    """Lines of a turn are square to the axis and to the way to it: ``d · axis = 0`` and ``d · (p - origin) = 0``."""
    middle = points.mean(axis=0)
    direction = np.linalg.eigh(np.einsum("n,ni,nj->ij", weight, lines, lines))[1][:, 0]
    flat = lines - (lines @ direction)[:, None] * direction
    H = np.einsum("n,ni,nj->ij", weight, flat, flat) + np.outer(direction, direction) * weight.sum()
    H += 1e-4 * weight.sum() * np.eye(3)  # nearly parallel lines leave the distance of the axis open
    g = np.einsum("n,ni,n->i", weight, flat, np.einsum("ni,ni->n", lines, points - middle))
    origin = middle + np.linalg.solve(H, g)
    way = np.cross(direction, points - origin)
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    return "revolute", origin, direction, _angle(lines, way)


def _angle(a: Array, b: Array) -> Array:
    """Angles between lines [rad], shape (n,)."""
    return np.arccos(np.clip(np.abs(np.einsum("ni,ni->n", a, np.broadcast_to(b, a.shape))), 0.0, 1.0))
