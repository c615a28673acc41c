"""Where and how to push a drawer inwards first: points of front and handle × approach directions, best first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from s2r_host.motion.fingertip import CLOSED_GRIPPER, Fingertip
from s2r_host.motion.front import Front

FIRST_POINTS = 4
HANDLE_FACE_M = 0.006  # how far below its outermost points a handle still counts as its face


@dataclass(frozen=True)
class PushSettings:
    """Geometry of the first push [m, rad]."""

    depth_m: float = 0.045
    standoff_m: float = 0.05
    edge_margin_m: float = 0.025
    handle_margin_m: float = 0.035
    grid_m: float = 0.02
    tilts_rad: tuple[float, ...] = (1.1, 0.85, 1.3, 0.6, 0.3)
    turns_rad: tuple[float, ...] = (0.0, 0.35, -0.35)
    rolls_rad: tuple[float, ...] = (0.0, 0.5 * np.pi)
    tip: Fingertip = CLOSED_GRIPPER


@dataclass(frozen=True, eq=False)
class PushProposal:
    """One push: start pose of the fingertip and the straight way it goes.

    Attributes:
        X_base_tool: Pose at the stand-off, shape (4, 4).
        p_contact: Where the tool frame's origin is at first touch [m], shape (3,).
        p_end: Where it is at the end of the push [m], shape (3,).
        direction: Unit vector of the push, shape (3,).
    """

    X_base_tool: np.ndarray
    p_contact: np.ndarray
    p_end: np.ndarray
    direction: np.ndarray


def push_points(front: Front, settings: PushSettings) -> np.ndarray:
    """Points of the front away from its edges and its handle [m], shape (n, 3), most central first."""
    flat = front.in_plane(front.p_plane)
    low, high = np.percentile(flat, 1, axis=0), np.percentile(flat, 99, axis=0)
    grid = [
        np.arange(a + settings.edge_margin_m, b - settings.edge_margin_m, settings.grid_m)
        for a, b in zip(low, high, strict=True)
    ]
    cells = np.array(np.meshgrid(*grid)).reshape(2, -1).T
    if not len(cells):
        cells = 0.5 * (low + high)[None]
    cells = cells[cKDTree(flat).query(cells)[0] < 0.01]
    if len(front.p_handle) and len(cells):
        cells = cells[cKDTree(front.in_plane(front.p_handle)).query(cells)[0] > settings.handle_margin_m]
    # Off-centre pushes twist the drawer in its rails; height hardly matters, so it only breaks ties.
    middle = 0.5 * (low + high)
    order = np.argsort(np.abs(cells[:, 0] - middle[0]) + 0.3 * np.abs(cells[:, 1] - middle[1]))
    return cells[order, :1] * front.across + cells[order, 1:] * front.upward + front.offset_m * front.normal


def handle_points(front: Front, count: int = 3) -> np.ndarray:
    """Points along the outermost face of the handle [m], shape (n, 3), the middle one first; none without a handle."""
    if not len(front.p_handle):
        return np.zeros((0, 3))
    height = front.p_handle @ front.normal - front.offset_m
    face = np.percentile(height, 95)
    flat = front.in_plane(front.p_handle[height > face - HANDLE_FACE_M])
    low, middle, high = np.percentile(flat[:, 0], [20, 50, 80])
    across = np.array([middle, *np.linspace(low, high, count - 1)])
    upward = np.array([np.median(flat[np.argsort(np.abs(flat[:, 0] - a))[:20], 1]) for a in across])
    return (
        across[:, None] * front.across
        + upward[:, None] * front.upward
        + (front.offset_m + face) * front.normal
    )


def push_proposals(
    front: Front, settings: PushSettings | None = None, max_points: int = 12
) -> Iterator[PushProposal]:
    """Proposals, best first: a steep to flat approach, and for each the points from central to outermost.

    The points are taken from all over the front: a wide handle may hide everything central. A few of them are tried
    with every approach before the others are; last comes the handle itself, which gives the fingertip little to press
    on, but stands free where it keeps the gripper from the front. The fingertip points along the push or tilted down
    from it.
    """
    settings = settings or PushSettings()
    direction = -front.normal
    points = push_points(front, settings)
    points = points[_spaced(len(points), max_points)]
    first = _spaced(len(points), FIRST_POINTS)
    for some in (points[first], np.delete(points, first, axis=0)):
        for R in _approaches(direction, settings):
            for point in some:
                # On a plane it does not matter which corner touches.
                corner = settings.tip.foremost_corner(R, direction) @ direction * direction
                yield _proposal(R, point - corner, direction, settings)
    for R in _approaches(direction, settings):
        for point in handle_points(front):
            yield _proposal(R, point - settings.tip.foremost_corner(R, direction), direction, settings)


def _approaches(direction: np.ndarray, settings: PushSettings) -> Iterator[np.ndarray]:
    for tilt, turn, roll in product(settings.tilts_rad, settings.turns_rad, settings.rolls_rad):
        yield tool_orientation(direction, tilt, turn, roll)


def _proposal(
    R_base_tool: np.ndarray, p_contact: np.ndarray, direction: np.ndarray, settings: PushSettings
) -> PushProposal:
    X = np.eye(4)
    X[:3, :3] = R_base_tool
    X[:3, 3] = p_contact - settings.standoff_m * direction
    return PushProposal(X, p_contact, p_contact + settings.depth_m * direction, direction)


def _spaced(count: int, at_most: int) -> np.ndarray:
    """Indices of at most so many of ``count`` things, evenly spaced, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(at_most, count)).astype(int))


def tool_orientation(direction: np.ndarray, tilt: float, turn: float, roll: float) -> np.ndarray:
    """Rotation R_base_tool with the tool's z along ``direction``, tilted down, turned about the vertical, rolled.

    Args:
        direction: Horizontal unit vector, shape (3,).
        tilt: Downward tilt of the tool's z [rad]; 0 = level.
        turn: Rotation about the vertical [rad].
        roll: Rotation about the tool's own z [rad].
    """
    heading = np.arctan2(direction[1], direction[0]) + turn
    z = np.array([np.cos(heading) * np.cos(tilt), np.sin(heading) * np.cos(tilt), -np.sin(tilt)])
    y = np.array([-np.sin(heading), np.cos(heading), 0.0])
    x = np.cross(y, z)
    R = np.column_stack([x, y, z])
    c, s = np.cos(roll), np.sin(roll)
    return R @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
