"""What is known of joints before looking: slides run square to fronts, hinges are upright or level, levers meet
their axis, which is that of the round body they sit on.

Each wish is a residual in units of its standard deviation. It holds only for a motion that is near it
already; a lid that is tilted for good is left alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.levers import Column, Lever
from s2r_host.perception.motion import JointMotion, perpendicular_basis, unit

Array = NDArray[np.floating]
Wish = Callable[[JointMotion], float]

FRONT_SIGMA_RAD = np.radians(1.0)
FRONT_CAPTURE_RAD = np.radians(12.0)
BESIDE_SIGMA_RAD = np.radians(0.5)
UPRIGHT_SIGMA_RAD = np.radians(2.0)
UPRIGHT_CAPTURE_RAD = np.radians(15.0)
PLUMB_SIGMA_RAD = np.radians(0.3)
PLUMB_CAPTURE_RAD = np.radians(20.0)
LEVER_SIGMA_M = 0.005
LEVER_CAPTURE_M = 0.012
COLUMN_SIGMA_M = 0.003
COLUMN_CAPTURE_M, COLUMN_CAPTURE_RAD = 0.02, np.radians(15.0)
LONGEST_LEVER_M = 0.2
SQUARE_SIGMA_RAD = np.radians(5.0)
SQUARE_CAPTURE_RAD = np.radians(25.0)


@dataclass(frozen=True, eq=False)
class Wishes:
    """Sources of wishes.

    Attributes:
        fronts: Unit normals of the large flat faces of the part, shape (n, 3): drawers run square to one of them.
        up: Unit vector against gravity; None if the frame does not tell.
        before, after: Lines of a thin part in both views, if it is thin.
        columns: Of round bodies that stayed, beside a small part.
        beside: Directions (3,) in which parts beside this one slide: drawers of one chest slide alike.
        upright_sigma_rad: How exactly a hinge that is nearly upright or level is that.
    """

    fronts: Array
    up: Array | None = None
    before: Lever | None = None
    after: Lever | None = None
    columns: tuple[Column, ...] = ()
    beside: tuple[Array, ...] = ()
    upright_sigma_rad: float = UPRIGHT_SIGMA_RAD

    @property
    def thin(self) -> bool:
        """The moving part looks like a lever; what moved of a drawer's front or a lid may be a longer strip."""
        return any(line is not None and line.length_m < LONGEST_LEVER_M for line in (self.before, self.after))

    def plumb(self) -> Wishes:
        """The same for hinges that were mounted upright or level."""
        return replace(self, upright_sigma_rad=PLUMB_SIGMA_RAD)

    def plumbed(self, motion: JointMotion) -> JointMotion | None:
        """A hinge that is nearly upright or level as if it were; None for others."""
        if self.up is None or motion.joint_type == "prismatic":
            return None
        along = float(motion.direction @ self.up)
        if abs(along) > np.cos(PLUMB_CAPTURE_RAD):
            return replace(motion, direction=np.sign(along) * self.up)
        if abs(along) < np.sin(PLUMB_CAPTURE_RAD):
            return replace(motion, direction=unit(motion.direction - along * self.up))
        return None

    def active(self, motion: JointMotion) -> list[Wish]:
        """The wishes that hold for motions near this one."""
        if motion.joint_type == "prismatic":
            return self._square_to_front(motion) + self._like_those_beside(motion)
        return self._upright_or_level(motion) + self._through_lever(motion) + self._about_column(motion)

    def _square_to_front(self, motion: JointMotion) -> list[Wish]:
        cosine = self.fronts @ motion.direction
        if len(cosine) == 0 or np.abs(cosine).max() < np.cos(FRONT_CAPTURE_RAD):
            return []
        normal = self.fronts[int(np.argmax(np.abs(cosine)))]
        return [_across(axis, FRONT_SIGMA_RAD) for axis in perpendicular_basis(normal)]

    def _like_those_beside(self, motion: JointMotion) -> list[Wish]:
        return [
            _across(axis, BESIDE_SIGMA_RAD)
            for one in self.beside
            if abs(float(one @ motion.direction)) > np.cos(FRONT_CAPTURE_RAD)
            for axis in perpendicular_basis(one)
        ]

    def _upright_or_level(self, motion: JointMotion) -> list[Wish]:
        if self.up is None:
            return []
        cosine = abs(float(motion.direction @ self.up))
        if cosine > np.cos(UPRIGHT_CAPTURE_RAD):
            return [_across(axis, self.upright_sigma_rad) for axis in perpendicular_basis(self.up)]
        if cosine < np.sin(UPRIGHT_CAPTURE_RAD):
            return [_across(self.up, self.upright_sigma_rad)]
        return []

    def _through_lever(self, motion: JointMotion) -> list[Wish]:
        found: list[Wish] = []
        level = self.up is not None and abs(float(motion.direction @ self.up)) < np.sin(UPRIGHT_CAPTURE_RAD)
        for line in (self.before, self.after):
            if line is None:
                continue
            sine = float(np.linalg.norm(np.cross(motion.direction, line.direction)))
            if sine > 0.5 and abs(_gap(motion, line)) < LEVER_CAPTURE_M:
                found.append(lambda m, line=line: _gap(m, line) / LEVER_SIGMA_M)
            if level and sine > np.cos(SQUARE_CAPTURE_RAD):
                found.append(_across(line.direction, SQUARE_SIGMA_RAD))
        return found

    def _about_column(self, motion: JointMotion) -> list[Wish]:
        """To be the axis of the nearest surely round body, if one is near and runs the same way."""
        near = [
            (gap, k)
            for k, one in enumerate(self.columns)
            if one.sure
            and abs(float(motion.direction @ one.direction)) > np.cos(COLUMN_CAPTURE_RAD)
            and (gap := float(np.linalg.norm(_offset(motion, one.centre)))) < COLUMN_CAPTURE_M
        ]
        if not near:
            return []
        column = self.columns[min(near)[1]]
        return [
            lambda m, axis=axis: float(_offset(m, column.centre) @ axis) / COLUMN_SIGMA_M
            for axis in perpendicular_basis(column.direction)
        ]


def _offset(motion: JointMotion, p: Array) -> Array:
    """From the joint's axis to a point, square to the axis [m], (3,)."""
    gap = p - motion.origin
    return gap - float(gap @ motion.direction) * motion.direction


def _across(axis: Array, sigma_rad: float) -> Wish:
    """The wish to be square to an axis."""
    return lambda motion: float(motion.direction @ axis) / sigma_rad


def _gap(motion: JointMotion, line: Lever) -> float:
    """Signed distance between the joint's axis and a line [m]."""
    normal = np.cross(motion.direction, line.direction)
    return float((line.centre - motion.origin) @ normal / max(np.linalg.norm(normal), 1e-9))
