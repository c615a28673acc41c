"""One-joint motions: a rotation about a line or a translation along a direction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_protocol.targets import JointType

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class JointMotion:
    """The motion of a part between two views.

    Attributes:
        joint_type: "revolute" or "prismatic".
        origin: A point on the axis [m], shape (3,).
        direction: Unit vector, shape (3,).
        delta: Motion from the first to the second view about or along ``direction`` [rad or m].
    """

    joint_type: JointType
    origin: Array
    direction: Array
    delta: float

    def transform(self) -> Array:
        """X (4, 4) that carries points of the part from the first view to the second."""
        X = np.eye(4)
        if self.joint_type == "prismatic":
            X[:3, 3] = self.delta * self.direction
        else:
            R = rotation(self.direction, self.delta)
            X[:3, :3], X[:3, 3] = R, self.origin - R @ self.origin
        return X

    def positive(self) -> JointMotion:
        """The same motion written with delta >= 0 (the direction carries the sign)."""
        if self.delta >= 0:
            return self
        return replace(self, direction=-self.direction, delta=-self.delta)


@dataclass(frozen=True, eq=False)
class Push:
    """What was done to the part between two views, where that is known: a point of it went this way.

    Attributes:
        p: Where it was pushed [m], shape (3,).
        direction: Unit vector of the push, shape (3,).
    """

    p: Array
    direction: Array

    def agrees(self, motion: JointMotion) -> bool:
        """Whether the point goes along the push rather than against it when the part moves like that."""
        way = motion.direction
        if motion.joint_type == "revolute":
            way = np.cross(motion.direction, self.p - motion.origin)
        return bool(np.sign(motion.delta) * (way @ self.direction) > 0.0)


def rotation(direction: Array, angle: float) -> Array:
    """Rotation matrix (3, 3) about a unit vector (Rodrigues)."""
    k = cross_matrix(direction)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def cross_matrix(v: Array) -> Array:
    """The matrix of ``v x``."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0.0]])


def unit(v: Array) -> Array:
    """``v`` scaled to length 1."""
    return v / np.linalg.norm(v)


def perpendicular_basis(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors that span the plane normal to ``direction``."""
    x, y, z = direction
    helper = int(np.argmin(np.abs(direction)))
    e1 = unit(np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))[helper]))
    a, b, c = e1
    return e1, np.array((y * c - z * b, z * a - x * c, x * b - y * a))


def line_distance(p_line: Array, direction: Array, points: Array) -> Array:
    """Distance of points (n, 3) from a line [m], shape (n,)."""
    return np.linalg.norm(np.cross(points - p_line, direction), axis=-1)
