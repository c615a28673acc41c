"""About which axes a piece that may be a lever can turn: an upright one, or a level one that it swings about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.motion.levers import LeverCandidate
from s2r_host.motion.standing import COLUMN_RADIUS_M

UP = np.array([0.0, 0.0, 1.0])
ROOT_M = (
    0.012  # the axis lies at least this far inside of the visible root: the hub is round, and not the lever's
)
FOOT_M = 0.010  # of a piece that stands on a foot of its own the foot is seen as well: the axis is this far within it
# Half-way between their stops levers mostly lead to the user, those at the side of a body at 35 degrees from upright.
MIDDLE_RAD = np.deg2rad(35.0)
FLAT = 0.5  # least cosine of a lever's rise at which the body's axis tells where along its line it turns
ASIDE_M = 0.012  # a line that passes the body's axis nearer than this is taken to pass through it
AT_BODY_M = COLUMN_RADIUS_M + 0.02  # a piece that begins nearer to the body's axis is mounted on the body


@dataclass(frozen=True, eq=False)
class LeverAxis:
    """An axis, base frame.

    Attributes:
        p: A point on it [m], (3,).
        direction: Unit vector, (3,).
    """

    p: np.ndarray
    direction: np.ndarray

    def way(self, p: np.ndarray) -> np.ndarray:
        """Unit vector in which a point (3,) of the piece sets off, in the axis' own sense, (3,)."""
        way = np.cross(self.direction, p - self.p)
        return way / max(float(np.linalg.norm(way)), 1e-9)

    def radius(self, p: np.ndarray) -> float:
        """Distance of a point (3,) from the axis [m]."""
        return float(np.linalg.norm(np.cross(self.direction, p - self.p)))


def upright_axis(lever: LeverCandidate) -> LeverAxis:
    """The upright axis that it turns about: the body's own for what is mounted on the body."""
    root, tip = (float(np.linalg.norm(p[:2] - lever.p_body)) for p in (lever.p_root, lever.p_tip))
    if root < min(tip, AT_BODY_M) and not lever.rooted:
        return LeverAxis(np.append(lever.p_body, lever.p_root[2]), UP)
    return LeverAxis(_hinge(lever), UP)


def level_axis(lever: LeverCandidate) -> LeverAxis:
    """The level axis that it swings about: from the body to what is mounted beside it, else square to its line."""
    out, away_m = np.append(_nearest(lever)[:2] - lever.p_body, 0.0), aside_m(lever)
    if away_m > ASIDE_M and not lever.rooted:
        return LeverAxis(_hinge(lever), out / away_m)
    flat = lever.direction * (1.0, 1.0, 0.0)
    length = float(np.linalg.norm(flat))
    return LeverAxis(_hinge(lever), np.cross(UP, lever.outward if length < 0.1 else flat / length))


def aside_m(lever: LeverCandidate) -> float:
    """How far its line passes beside the body's axis, seen from above [m]."""
    return float(np.linalg.norm(_nearest(lever)[:2] - lever.p_body))


def with_room_first(axis: LeverAxis, lever: LeverCandidate) -> LeverAxis:
    """The axis in the sense in which the piece probably has more way to its stop: to where levers mostly lead."""
    to_arm = -lever.p_tip * (1.0, 1.0, 0.0)
    middle = np.cos(MIDDLE_RAD) * UP + np.sin(MIDDLE_RAD) * to_arm / max(float(np.linalg.norm(to_arm)), 1e-9)
    return axis if axis.way(lever.p_tip) @ middle >= 0.0 else LeverAxis(axis.p, -axis.direction)


def _hinge(lever: LeverCandidate) -> np.ndarray:
    """Where on its line it turns (3,): at the body's axis if the column may hide that, else at the foot of its root."""
    d = lever.direction
    away_m = aside_m(lever)
    if lever.rooted or away_m > COLUMN_RADIUS_M:
        return lever.p_root + FOOT_M * d
    flat = float(np.linalg.norm(d[:2]))
    back_m = ROOT_M if away_m < ASIDE_M else -FOOT_M
    if flat > FLAT:
        hidden_m = float(np.sqrt(COLUMN_RADIUS_M**2 - away_m**2))
        behind_m = float((lever.p_root[:2] - lever.p_body) @ d[:2]) / flat
        back_m = float(np.clip(behind_m, back_m, hidden_m)) / flat
    return lever.p_root - back_m * d


def _nearest(lever: LeverCandidate) -> np.ndarray:
    """The point of its line (3,), up to where the column hides it, that is nearest to the body's axis from above."""
    d = lever.direction
    flat = max(float(d[:2] @ d[:2]), 1e-9)
    t = float((lever.p_body - lever.p_root[:2]) @ d[:2]) / flat
    return lever.p_root + float(np.clip(t, -COLUMN_RADIUS_M, np.linalg.norm(lever.p_tip - lever.p_root))) * d
