"""Places where the hand is free and its fingertip could push the part along its motion."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np

from s2r_host.planning.hand_probe import HandProbe, quats_of
from s2r_host.planning.scene import GeomKind, Scene
from s2r_host.planning.settings import USUAL_ROOM_M

_PAD_M = (0.018, 0.004)  # the point that should meet the part, this far behind the end of the fingertip
_DEEP_PAD_M = (0.018, 0.012)  # the same where the part may end earlier than believed
_BEHIND_M = (0.010, 0.014, 0.018, 0.024)  # how far behind a geom places are looked for
_FAR_BEHIND_M = (0.030, 0.036)  # and where more room is asked for
_PUSH_M = (0.003, 0.006, 0.009, 0.012, 0.016, 0.024, 0.034)  # how far along the motion the part is felt for
_BACK_M = (0.02, 0.05, 0.09)  # how far the hand must be able to back out
_WAY_OUT_M = (
    0.3  # free along the tool's axis behind a place: the hand is that long, and the arm comes after it
)
_FACING = 0.5  # cosine between a face's normal and the motion from which on the face can be pushed
_LEAST_LEVER = 0.25  # of the part's longest, from which on a point is worth pushing
_ROOM_M = (0.003, 0.006)  # sideways steps that tell a roomy place from a tight one
_STEP_M, _FINE_STEP_M, _SMALL_M = 0.02, 0.008, 0.022
_START_M, _NARROW_M = (
    0.001,
    0.032,
)  # where rays begin behind a face; a gap in which the middle is the only place
_SOLID_GROUP = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)  # see _only_solid


@dataclass(frozen=True, eq=False)
class Places:
    """Tool poses in the world frame at the present state of the object.

    Attributes:
        p: Tool tips [m], (n, 3).
        R: Tool orientations, (n, 3, 3).
        way: Unit direction of the part's wanted motion there, (n, 3).
        push_m: How far along it the fingertip meets the part, (n,).
        blocked: How many of ten small steps aside or deeper would touch something, (n,).
    """

    p: np.ndarray
    R: np.ndarray
    way: np.ndarray
    push_m: np.ndarray
    blocked: np.ndarray

    def __len__(self) -> int:
        return len(self.p)


def find_places(
    scene: Scene,
    data: mujoco.MjData,
    probe: HandProbe,
    sign: float,
    points: int,
    *,
    ways: str = "usual",
    room_m: float = USUAL_ROOM_M,
    deep: bool = False,
) -> Places:
    """Places found around the part for motion towards growing (sign 1) or falling s (-1); maybe none.

    They are looked for at up to ``points`` points, spread over the faces of the part. The hand may come in ``ways``:
    "usual", level and from above; "oblique", slantwise as well, as behind an upright bar close to its door; "upward",
    from below, as to what is overhead. With more than the usual room to the touch, ``room_m``, they are looked for
    further behind the part, too. ``deep``: none that only grazes it.
    """
    behind_m = (*_BEHIND_M, *_FAR_BEHIND_M) if room_m > USUAL_ROOM_M else _BEHIND_M
    pads = _DEEP_PAD_M if deep else _PAD_M
    p, R, way = _candidates(scene, data, sign, _ORIENTATIONS[ways], points, behind_m, pads)
    quat = quats_of(R)
    free = probe.contacts(p, quat) == 0
    p, R, way, quat = p[free], R[free], way[free], quat[free]
    push_m = _push_distances(probe, p, quat, way)
    good = np.isfinite(push_m)
    for back in _BACK_M:
        good[good] = probe.contacts((p - back * R[:, :, 2])[good], quat[good]) == 0
    p, R, way, quat, push_m = p[good], R[good], way[good], quat[good], push_m[good]
    return Places(p, R, way, push_m, _blocked_steps(probe, p, R, quat, way))


def _push_distances(probe: HandProbe, p: np.ndarray, quat: np.ndarray, way: np.ndarray) -> np.ndarray:
    """How far along the motion the fingertip alone meets the part, (n,); infinite if it never does or more does."""
    push_m = np.full(len(p), np.inf)
    left = np.arange(len(p))
    for push in _PUSH_M:
        moved = p[left] + push * way[left]
        total = probe.contacts(moved, quat[left])
        finger = np.zeros(len(left), dtype=int)
        finger[total > 0] = probe.finger_contacts(moved[total > 0], quat[left[total > 0]])
        push_m[left[(finger > 0) & (finger == total)]] = push
        left = left[total == 0]
    return push_m


def _blocked_steps(
    probe: HandProbe, p: np.ndarray, R: np.ndarray, quat: np.ndarray, way: np.ndarray
) -> np.ndarray:
    """How many small steps aside or deeper would touch something, (n,); longer ones towards the part may."""
    blocked = np.zeros(len(p), dtype=int)
    for column, side in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0)):
        step = side * R[:, :, column]
        towards_part = np.einsum("ni,ni->n", step, way) > 0.7
        blocked += probe.contacts(p + _ROOM_M[0] * step, quat) > 0
        blocked += (probe.contacts(p + _ROOM_M[1] * step, quat) > 0) & ~towards_part
    return blocked


def part_box(scene: Scene, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Axis-aligned box of the part's colliding geoms in the world, two (3,) [m]."""
    corners = _corners(scene, data, part_geoms(scene))
    return corners.min(axis=0), corners.max(axis=0)


def outermost_lever(scene: Scene, data: mujoco.MjData) -> float:
    """Way that the outermost point of the part makes per unit of s: a radius [m] about a hinge, 1 on a slide."""
    return float(scene.lever(data, _corners(scene, data, part_geoms(scene))).max())


def tightness(places: Places, room_m: float) -> np.ndarray:
    """Cost of places that leave little room or are far from the touch, (n,), in units of radians of travel.

    Room towards the part counts most: a fingertip that comes down within a few millimetres of an edge lands on it
    when the object stands a little nearer than believed, and jams there.
    """
    near, far = np.maximum(room_m - places.push_m, 0.0), np.maximum(places.push_m - (room_m + 0.004), 0.0)
    return 0.2 * places.blocked + 150.0 * near + 5.0 * far


def _candidates(
    scene: Scene,
    data: mujoco.MjData,
    sign: float,
    orientations: np.ndarray,
    count: int,
    behind_m: tuple[float, ...],
    pads: tuple[float, ...],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tool tips, orientations and directions worth a closer look, at ``count`` points behind the part.

    The point that should meet the part is ``pads`` behind the end of the fingertip, that ``behind_m`` behind the part.
    """
    seen = _only_solid(scene)
    centres, ways = _points_behind(scene, seen, data, sign, behind_m)
    axes = orientations[::_ROLLS, :, 2]
    free = [
        _free_along(seen, data, centre, -axes @ _frame(way).T) > _WAY_OUT_M
        for centre, way in zip(centres, ways, strict=True)
    ]
    open_at = np.flatnonzero([some.any() for some in free])  # most places inside a cabinet have no way out
    chosen = open_at[_spread(centres[open_at], count)]
    tips, rotations, directions = [], [], []
    for index in chosen:
        R = _frame(ways[index]) @ orientations[np.repeat(free[index], _ROLLS)]
        for pad in pads:
            tips.append(centres[index] + pad * R[:, :, 2])
            rotations.append(R)
            directions.append(np.broadcast_to(ways[index], (len(R), 3)))
    if not tips:
        return np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3))
    return np.concatenate(tips), np.concatenate(rotations), np.concatenate(directions)


def part_geoms(scene: Scene) -> np.ndarray:
    """Indices of the geoms of the part that can be touched."""
    return np.flatnonzero((scene.geom_kind == GeomKind.PART) & scene.solid)


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
    keep = all_points[:, 2] > 0.012 if scene.on_table else np.ones(len(all_points), dtype=bool)
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
    starts = [np.zeros((0, 3))]
    for axis, side in product(range(3), (-1.0, 1.0)):
        grid = [_along(reach[other], per_side) for other in range(3)]
        grid[axis] = np.array([side * (reach[axis] + _START_M)])
        local = middle + np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
        p = data.geom_xpos[geom] + local @ R.T
        starts.append(p[scene.part_motion(data, p) @ R[:, axis] * sign * side < -_FACING])
    p = np.concatenate(starts)
    p = p[scene.lever(data, p) > least_lever_m]
    return p, sign * scene.part_motion(data, p)


def _corners(scene: Scene, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Corners of the boxes around geoms in the world [m], (8 n, 3)."""
    signs = np.array(list(product((-1.0, 1.0), repeat=3)))
    local = scene.fine.geom_aabb[geoms, None, :3] + signs * scene.fine.geom_aabb[geoms, None, 3:]
    R = data.geom_xmat[geoms].reshape(-1, 3, 3)
    return (data.geom_xpos[geoms, None] + np.einsum("gij,gkj->gki", R, local)).reshape(-1, 3)


def _along(reach_m: float, most: int) -> np.ndarray:
    """Even places along one side of a box of half length ``reach_m``; denser on small geoms."""
    count = int(np.clip(np.ceil(2.0 * reach_m / (_STEP_M if reach_m > _SMALL_M else _FINE_STEP_M)), 1, most))
    return ((np.arange(count) + 0.5) / count * 2.0 - 1.0) * reach_m


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
    if not 0.0 <= ahead_m < _PUSH_M[-1] or scene.geom_kind[geom[0]] != GeomKind.PART:
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


def _frame(way: np.ndarray) -> np.ndarray:
    """Columns ahead, aside, up for a unit direction; level if the direction is not steep, (3, 3)."""
    level = np.array([way[0], way[1], 0.0])
    length = np.sqrt(level @ level)
    x, y = (level[:2] / length) if length > 0.3 else (1.0, 0.0)
    return np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])


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


def _spread(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of up to ``count`` points far from each other, beginning with the first."""
    if len(points) <= count:
        return np.arange(len(points))
    chosen = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


_ROLLS = 2  # orientations per axis in the table, next to each other
_ORIENTATIONS = {
    "usual": _orientation_table((0.0, 1.0), slanting_too=False),
    "oblique": _orientation_table((0.0, 0.35, 1.0), slanting_too=True),
    "upward": _orientation_table((-0.5, -1.0), slanting_too=True),
}
