"""Tool poses worth a closer look: behind the faces of a part that its motion leaves behind, with a way out.

Found with rays alone; :mod:`s2r_host.planning.places` tries the hand there.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from itertools import product

import mujoco
import numpy as np

from s2r_host.planning.part_shape import outermost_lever, part_geoms
from s2r_host.planning.scene import GeomKind, Scene
from s2r_host.planning.settings import USUAL_ROOM_M

FELT_FOR_M = 0.034  # the part is met along its motion within this
_PAD_M = (0.018, 0.004)  # the point that should meet the part, this far behind the end of the fingertip
_DEEP_PAD_M = (0.018, 0.012)  # the same where the part may end earlier than believed
_BEHIND_M = (0.010, 0.014, 0.018, 0.024)  # how far behind a geom places are looked for
_FAR_BEHIND_M = (0.030, 0.036)  # and where more room is asked for
# Free along the tool's axis behind a place: the hand is that long, and the arm comes after it.
_WAY_OUT_M = 0.3
_FACING = 0.5  # cosine between a face's normal and the motion from which on the face can be pushed
_LEAST_LEVER = 0.25  # of the part's longest, from which on a point is worth pushing
_STEP_M, _FINE_STEP_M, _SMALL_M = 0.02, 0.008, 0.022
# Where rays begin behind a face; a gap in which the middle is the only place.
_START_M, _NARROW_M = 0.001, 0.032
_LEAST_HEIGHT_M = 0.012  # over the table
_SOLID_GROUP = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)  # see _only_solid


def find_candidates(
    scene: Scene, data: mujoco.MjData, sign: float, count: int, *, ways: str, room_m: float, deep: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tool tips (n, 3) [m], orientations (n, 3, 3) and the part's directions of motion there (n, 3), world frame.

    At up to ``count`` points behind the part, as it moves towards growing (``sign`` 1) or falling s (-1). For ``ways``,
    ``room_m`` and ``deep`` see :class:`s2r_host.planning.places.PlaceSearch`.
    """
    behind_m = (*_BEHIND_M, *_FAR_BEHIND_M) if room_m > USUAL_ROOM_M else _BEHIND_M
    seen = _only_solid(scene)
    centres, motions = _points_behind(scene, seen, data, sign, behind_m)
    orientations, frames = _ORIENTATIONS[ways], _frames(motions)
    axes = orientations[::_ROLLS, :, 2]
    free: dict[int, np.ndarray] = {}

    def has_way_out(index: int) -> bool:
        out = _free_along(seen, data, centres[index], -axes @ frames[index].T) > _WAY_OUT_M
        free[index] = np.repeat(out, _ROLLS)
        return bool(out.any())

    tips, rotations, directions = [np.zeros((0, 3))], [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    for index in _spread(centres, count, has_way_out):
        R = frames[index] @ orientations[free[index]]
        for pad in _DEEP_PAD_M if deep else _PAD_M:
            tips.append(centres[index] + pad * R[:, :, 2])
            rotations.append(R)
            directions.append(np.broadcast_to(motions[index], (len(R), 3)))
    return np.concatenate(tips), np.concatenate(rotations), np.concatenate(directions)


def _points_behind(
    scene: Scene, seen: mujoco.MjModel, data: mujoco.MjData, sign: float, behind_m: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Points behind the faces of the part's geoms, as it moves, and the part's direction there, two (n, 3).

    Geom by geom, because a grid around the whole part would miss a thin bar. From just behind a face a ray finds the
    part ahead and another whatever lies behind: in a narrow gap the point is its middle, else some distances.
    """
    geoms = part_geoms(scene)
    per_side = 9 if len(geoms) <= 16 else 4
    points, ways = [np.zeros((0, 3))], [np.zeros((0, 3))]
    least_lever_m = _LEAST_LEVER * outermost_lever(scene, data)
    for geom in geoms:
        starts = _starts(scene, data, geom, sign, per_side, least_lever_m)
        for start, way in zip(*starts, strict=True):
            found = _in_gap(scene, seen, data, start, way, behind_m)
            points.append(found)
            ways.append(np.broadcast_to(way, found.shape))
    all_points, all_ways = np.concatenate(points), np.concatenate(ways)
    if not scene.on_table:
        return all_points, all_ways
    keep = all_points[:, 2] > _LEAST_HEIGHT_M
    return all_points[keep], all_ways[keep]


def _starts(
    scene: Scene, data: mujoco.MjData, geom: int, sign: float, per_side: int, least_lever_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """A grid just off each side of a geom's box where the motion leaves that side behind, with the motion, two (n, 3).

    The motion is that of each point: the two wings of a tap that turns about its middle move opposite ways. Points
    so near a hinge that pushing them would need many times the force of the best are left out.
    """
    R = data.geom_xmat[geom].reshape(3, 3)
    middle, reach = scene.fine.geom_aabb[geom, :3], scene.fine.geom_aabb[geom, 3:]
    grid, normals = _off_each_side(tuple(_count_along(float(length), per_side) for length in reach))
    p = data.geom_xpos[geom] + (middle + grid * reach + _START_M * normals) @ R.T
    motion = sign * scene.part_motion(data, p)
    p, motion = (rows[np.vecdot(motion, normals @ R.T) < -_FACING] for rows in (p, motion))
    far = scene.lever(data, p) > least_lever_m
    return p[far], motion[far]


@functools.cache
def _off_each_side(counts: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Even points on the sides of a box of half length 1, so many along each of its axes, and normals, two (n, 3)."""
    points, normals = [], []
    for axis, side in product(range(3), (-1.0, 1.0)):
        along = [(np.arange(count) + 0.5) / count * 2.0 - 1.0 for count in counts]
        along[axis] = np.array([side])
        points.append(np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 3))
        normals.append(np.tile(side * np.eye(3)[axis], (len(points[-1]), 1)))
    return np.concatenate(points), np.concatenate(normals)


def _count_along(reach_m: float, most: int) -> int:
    """Number of even places along one side of a box of half length ``reach_m``; denser on small geoms."""
    return int(np.clip(np.ceil(2.0 * reach_m / (_STEP_M if reach_m > _SMALL_M else _FINE_STEP_M)), 1, most))


def _in_gap(
    scene: Scene,
    seen: mujoco.MjModel,
    data: mujoco.MjData,
    start: np.ndarray,
    way: np.ndarray,
    distances_m: tuple[float, ...],
) -> np.ndarray:
    """Points on the line through a start along the motion, between the part ahead and what lies behind, (n, 3)."""
    geom = np.zeros(1, dtype=np.int32)
    ahead_m = mujoco.mj_ray(seen, data, start, way, _SOLID_GROUP, 1, -1, geom)
    if not 0.0 <= ahead_m < FELT_FOR_M or scene.geom_kind[geom[0]] != GeomKind.PART:
        return np.zeros((0, 3))
    behind_m = mujoco.mj_ray(seen, data, start, -way, _SOLID_GROUP, 1, -1, geom)
    gap_m = ahead_m + (behind_m if behind_m >= 0.0 else np.inf)
    surface = start + ahead_m * way
    if gap_m < _NARROW_M:
        return (surface - 0.5 * gap_m * way)[None]
    room = [back for back in distances_m if back < gap_m - distances_m[0]]
    return surface - np.array(room)[:, None] * way


def _free_along(
    seen: mujoco.MjModel, data: mujoco.MjData, point: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    """Free distance [m] from a point along unit directions (n, 3); the arm itself does not count, (n,)."""
    count = len(directions)
    geoms, distances = np.zeros(count, dtype=np.int32), np.zeros(count)
    rays = np.ascontiguousarray(directions).ravel()
    mujoco.mj_multiRay(seen, data, point, rays, _SOLID_GROUP, 1, -1, geoms, distances, None, count, 1.0)
    return np.where(geoms < 0, np.inf, distances)


def _only_solid(scene: Scene) -> mujoco.MjModel:
    """The fine model with what can be touched, the robot excepted, in geom group 0 and the rest in group 5."""
    model = copy.copy(scene.fine)
    touchable = scene.solid & (scene.geom_kind < GeomKind.ROBOT)
    model.geom_group[:] = np.where(touchable, 0, 5)
    return model


def _spread(points: np.ndarray, count: int, is_good: Callable[[int], bool]) -> list[int]:
    """Indices of up to ``count`` good points (n, 3) far from each other, beginning with the first.

    Only those are asked about that would be next: inside a cabinet most points have no way out.
    """
    chosen: list[int] = []
    distance = np.full(len(points), np.inf)
    while len(chosen) < count and len(points):
        index = int(distance.argmax())
        if distance[index] < 0.0:
            return sorted(chosen)  # all that are good
        if is_good(index):
            chosen.append(index)
            distance = np.minimum(distance, np.linalg.norm(points - points[index], axis=1))
        distance[index] = -1.0
    return chosen


def _frames(ways: np.ndarray) -> np.ndarray:
    """Columns ahead, aside, up for unit directions (n, 3); level if the direction is not steep, (n, 3, 3)."""
    length = np.hypot(ways[:, 0], ways[:, 1])
    steep = length <= 0.3
    x, y = np.where(steep, [[1.0], [0.0]], ways[:, :2].T / np.maximum(length, 0.3))
    frames = np.zeros((len(ways), 3, 3))
    frames[:, 0, 0], frames[:, 1, 0] = x, y
    frames[:, 0, 1], frames[:, 1, 1] = -y, x
    frames[:, 2, 2] = 1.0
    return frames


def _orientation_table(down_shares: tuple[float, ...], *, slanting_too: bool) -> np.ndarray:
    """Tool orientations in the frame ahead-aside-up, thin or wide side on, (n, 3, 3)."""
    rotations = []
    for ahead in (-1.0, -0.5, -0.25, 0.0, 0.5, 1.0):
        for aside in (-1.0, 0.0, 1.0):
            for down in down_shares:
                axis = np.array([ahead, aside, -down])
                slanting = down < 1.0 and aside != 0.0 and ahead != 0.0
                if np.linalg.norm(axis) < 0.9 or (slanting and not slanting_too):
                    continue
                z = axis / np.linalg.norm(axis)
                x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
                x /= np.linalg.norm(x)
                y = np.cross(z, x)
                # Half turns look the same.
                rotations += [np.column_stack([x, y, z]), np.column_stack([y, -x, z])]
    return np.array(rotations)


_ROLLS = 2  # orientations per axis in the table, next to each other
_ORIENTATIONS = {
    "usual": _orientation_table((0.0, 1.0), slanting_too=False),
    "oblique": _orientation_table((0.0, 0.35, 1.0), slanting_too=True),
    "upward": _orientation_table((-0.5, -1.0), slanting_too=True),
}
