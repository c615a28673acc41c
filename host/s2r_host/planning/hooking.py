"""Where the fingertip should push the part: a free place on the side that faces away from the wanted motion.

The paper measures the distance to the part's centre. For a drawer that has to be pulled, the centre lies inside the
front, and the nearest reachable place is in front of the handle, where nothing can be pulled. So a floating copy of
the hand is tried, without physics, at many places around the part: a place is good when the hand is free there, the
fingertip alone meets the part when it goes a little along the part's motion, the hand can back out along its own
axis, and the whole arm has a collision-free joint solution there, both at the start and at the target.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import mujoco
import mujoco.batch
import numpy as np

from s2r_host.errors import HostError
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.kinematics import ToolKinematics
from s2r_host.planning.scene import FINGER_PREFIX, GeomKind, Scene
from s2r_host.planning.settings import PlanSettings
from s2r_protocol.exits import RefusedError

logger = logging.getLogger(__name__)

PAD_M = 0.012  # the point that should meet the part, this far behind the end of the fingertip
_PUSH_M = (0.008, 0.016, 0.024, 0.034)  # how far along the motion the part is felt for
_BACK_M = (0.02, 0.05, 0.09)  # how far the hand must be able to back out
_BEHIND_M = (0.010, 0.016, 0.024)  # how far behind a geom places are looked for
_STEP_M, _SPREAD = 0.02, 160


class OutOfReachError(HostError, RefusedError):
    """The arm cannot get its fingertip to where the part could be pushed."""


@dataclass(frozen=True, eq=False)
class Hook:
    """A place for the fingertip.

    Attributes:
        p_part: Tool tip in the part's frame [m], (3,).
        p_world: The same in the world frame at the start.
        R_world_tool: Orientation of the tool there at the start, (3, 3).
        q: Joint solution there [rad], (dof,).
        q_end: Joint solution where the place is when the part has reached the target.
        clearance_m: How far the part is from the fingertip along the motion.
    """

    p_part: np.ndarray
    p_world: np.ndarray
    R_world_tool: np.ndarray
    q: np.ndarray
    q_end: np.ndarray
    clearance_m: float


class HandProbe:
    """The hand as a free body among the object's geoms; says where it would touch what."""

    def __init__(self, scene: Scene, data: mujoco.MjData, threads: int) -> None:
        spec = mujoco.MjSpec()
        model = scene.fine
        for geom in range(model.ngeom):
            if scene.geom_kind[geom] <= GeomKind.PART and model.geom_contype[geom]:
                _copy_geom(spec, spec.worldbody, model, geom, data.geom_xpos[geom], data.geom_xmat[geom])
        hand = spec.worldbody.add_body(name="hand")
        hand.add_freejoint()
        hand.mass, hand.inertia, hand.explicitinertial = 1.0, [0.01, 0.01, 0.01], True
        p_tool, R_tool = data.site_xpos[scene.tool_site], data.site_xmat[scene.tool_site].reshape(3, 3)
        weld = model.body_weldid[model.site_bodyid[scene.tool_site]]
        for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] == weld):
            R_geom = R_tool.T @ data.geom_xmat[geom].reshape(3, 3)
            p_geom = R_tool.T @ (data.geom_xpos[geom] - p_tool)
            _copy_geom(spec, hand, model, int(geom), p_geom, R_geom.ravel())
        everything = spec.compile()
        fingers = spec.compile()
        self._finger = np.array(
            [everything.geom(g).name.startswith(FINGER_PREFIX) for g in range(everything.ngeom)]
        )
        part = {model.geom(int(g)).name for g in np.flatnonzero(scene.geom_kind == GeomKind.PART)}
        is_part = np.array([everything.geom(g).name in part for g in range(everything.ngeom)])
        in_hand = everything.geom_bodyid == everything.body("hand").id
        fingers.geom_contype[in_hand & ~self._finger] = 0
        fingers.geom_conaffinity[in_hand & ~self._finger] = 0
        fingers.geom_contype[~in_hand & ~is_part] = 0
        fingers.geom_conaffinity[~in_hand & ~is_part] = 0
        self._all = mujoco.batch.Batch(everything, nsim=256, nthread=threads)
        self._fingers = mujoco.batch.Batch(fingers, nsim=256, nthread=threads)

    def contacts(self, p_world: np.ndarray, quat_wxyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Contacts of the hand with anything, and of its fingers with the part, (n,) each, at n tool poses."""
        poses = np.concatenate([p_world, quat_wxyz], axis=1)
        return _count(self._all, poses), _count(self._fingers, poses)


def find_hook(
    scene: Scene, world: FineWorld, object_mjcf: str | Path, s_target: float, settings: PlanSettings
) -> Hook:
    """The best place for the fingertip to move the part from its present state to ``s_target``.

    Raises:
        OutOfReachError: There is no free place behind the part, or the arm reaches none of them.
    """
    data = world.data
    sign = np.sign(s_target - world.s)
    probe = HandProbe(scene, data, settings.threads)
    p_world, R_world, clearance = _free_places(scene, data, probe, sign)
    if not len(p_world):
        raise OutOfReachError(
            f"object {Path(object_mjcf).name}: the fingertip fits nowhere behind the part that joint "
            f"{scene.joint!r} moves towards s = {s_target:.3f}; is there a gap behind the handle?"
        )
    order = _preference(scene, data, p_world, R_world, clearance)
    tool = ToolKinematics(scene, settings.joint_margin_rad)
    best: tuple[float, Hook] | None = None
    for index in order[: settings.hooks]:
        hook = _solve(scene, world, tool, p_world[index], R_world[index], float(clearance[index]), s_target)
        if hook is None:
            continue
        travel = (
            np.abs(hook.q - world.q).max() + 0.5 * np.abs(hook.q_end - hook.q).max() + 10.0 * hook.clearance_m
        )
        if best is None or travel < best[0]:
            best = (float(travel), hook)
    if best is None:
        nearest = np.linalg.norm(p_world, axis=1).min()
        raise OutOfReachError(
            f"object {Path(object_mjcf).name}: out of reach: the arm {scene.arm.name!r} has no collision-free joint "
            f"solution at any of {min(len(order), settings.hooks)} places behind the part "
            f"(nearest {nearest:.2f} m from the base) both now and at s = {s_target:.3f}; move the object"
        )
    logger.debug(
        "hook at %s m in the part's frame, %d free places", np.round(best[1].p_part, 3), len(p_world)
    )
    return best[1]


def _free_places(
    scene: Scene, data: mujoco.MjData, probe: HandProbe, sign: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tool tips (n, 3), rotations (n, 3, 3) and clearances (n,) [m] where the hand is free and can push."""
    centres = _points_behind(scene, data, sign)
    directions = sign * scene.part_motion(data, centres)
    keep = _sees_part(scene, data, centres, directions)
    chosen = np.flatnonzero(keep)[_spread(centres[keep], _SPREAD)]
    tips, rotations, ways = [], [], []
    for centre, direction in zip(centres[chosen], directions[chosen], strict=True):
        for R in _orientations(direction):
            if _ray(scene, data, centre, -R[:, 2])[0] > _BACK_M[-1] + PAD_M:
                tips.append(centre + PAD_M * R[:, 2])
                rotations.append(R)
                ways.append(direction)
    if not tips:
        return np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0)
    p, R, way = np.array(tips), np.array(rotations), np.array(ways)
    quat = np.array([_quat(r) for r in R])
    free = probe.contacts(p, quat)[0] == 0
    p, R, way, quat = p[free], R[free], way[free], quat[free]
    clearance = np.full(len(p), np.inf)
    blocked = np.zeros(len(p), dtype=bool)
    for push in _PUSH_M:
        total, finger = probe.contacts(p + push * way, quat)
        open_ = ~blocked & np.isinf(clearance)
        clearance[open_ & (finger > 0) & (finger == total)] = push
        blocked |= open_ & (total > finger)
    good = np.isfinite(clearance)
    for back in _BACK_M:
        good[good] = probe.contacts((p - back * R[:, :, 2])[good], quat[good])[0] == 0
    return p[good], R[good], clearance[good]


def _points_behind(scene: Scene, data: mujoco.MjData, sign: float) -> np.ndarray:
    """Points a finger's half thickness and more behind every geom of the part, as it moves, (n, 3).

    Geom by geom, because a grid around the whole part would miss a thin bar.
    """
    model = scene.fine
    geoms = np.flatnonzero((scene.geom_kind == GeomKind.PART) & (model.geom_contype != 0))
    per_side = 9 if len(geoms) <= 16 else 4
    points = []
    for geom in geoms:
        R = data.geom_xmat[geom].reshape(3, 3)
        centre = data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3]
        ahead = sign * scene.part_motion(data, centre)
        across = np.cross(ahead, [0.0, 0.0, 1.0] if abs(ahead[2]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        frame = np.column_stack([ahead, across, np.cross(ahead, across)])
        reach = np.abs(frame.T @ R) @ model.geom_aabb[geom, 3:]
        counts = [int(np.clip(np.ceil(2.0 * r / _STEP_M), 1, per_side)) for r in reach[1:]]
        sides = [(np.arange(n) + 0.5) / n * 2.0 - 1.0 for n in counts]
        for behind in _BEHIND_M:
            for u in sides[0]:
                for v in sides[1]:
                    points.append(centre + frame @ [-reach[0] - behind, u * reach[1], v * reach[2]])
    above = np.array(points)
    return above[above[:, 2] > 0.012]


def _part_box(scene: Scene, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Axis-aligned box of the part's colliding geoms in the world, two (3,) [m]."""
    model = scene.fine
    part = np.flatnonzero((scene.geom_kind == GeomKind.PART) & (model.geom_contype != 0))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in part:
        R = data.geom_xmat[geom].reshape(3, 3)
        centre = data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3]
        reach = np.abs(R) @ model.geom_aabb[geom, 3:]
        low, high = np.minimum(low, centre - reach), np.maximum(high, centre + reach)
    return low, high


def _sees_part(scene: Scene, data: mujoco.MjData, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Points from which the part is the first thing met along the direction, within the feeling distance."""
    keep = np.zeros(len(points), dtype=bool)
    for i, (point, direction) in enumerate(zip(points, directions, strict=True)):
        distance_m, geom = _ray(scene, data, point, direction)
        keep[i] = 0.004 < distance_m < _PUSH_M[-1] + 0.01 and scene.geom_kind[geom] == GeomKind.PART
    return keep


def _ray(scene: Scene, data: mujoco.MjData, point: np.ndarray, direction: np.ndarray) -> tuple[float, int]:
    """Distance [m] to the first geom of object or table along a unit direction, and that geom; inf and -1 for none."""
    geom = np.zeros(1, dtype=np.int32)
    distance_m = mujoco.mj_ray(scene.fine, data, point, direction, None, 1, -1, geom)
    if geom[0] < 0 or scene.geom_kind[geom[0]] >= GeomKind.ROBOT:
        return np.inf, -1
    return float(distance_m), int(geom[0])


def _orientations(direction: np.ndarray) -> list[np.ndarray]:
    """Tool rotations to try for a push along ``direction``: axes that do not point up, thin or wide side on."""
    level = np.array([direction[0], direction[1], 0.0])
    ahead = level / np.linalg.norm(level) if np.linalg.norm(level) > 0.3 else np.array([1.0, 0.0, 0.0])
    side = np.cross([0.0, 0.0, 1.0], ahead)
    down = np.array([0.0, 0.0, -1.0])
    rotations = []
    for a in (-1.0, -0.5, -0.25, 0.0, 0.5, 1.0):
        for b in (-1.0, 0.0, 1.0):
            for c in (0.0, 1.0):
                axis = a * ahead + b * side + c * down
                if np.linalg.norm(axis) < 0.9 or (c == 0.0 and b != 0.0 and a != 0.0):
                    continue
                z = axis / np.linalg.norm(axis)
                x = np.cross(side if abs(z @ side) < 0.9 else ahead, z)
                x /= np.linalg.norm(x)
                y = np.cross(z, x)
                for first, second in ((x, y), (y, -x)):  # half turns look the same
                    rotations.append(np.column_stack([first, second, z]))
    return rotations


def _preference(
    scene: Scene, data: mujoco.MjData, p: np.ndarray, R: np.ndarray, clearance: np.ndarray
) -> np.ndarray:
    """Order in which places are given to the inverse kinematics: little turning, little way, a long lever."""
    p_now = data.site_xpos[scene.tool_site]
    R_now = data.site_xmat[scene.tool_site].reshape(3, 3)
    cosine = (np.einsum("nij,ij->n", R, R_now) - 1.0) / 2.0
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    way = np.linalg.norm(p - p_now, axis=1)
    low, high = _part_box(scene, data)
    centre = (low + high) / 2.0
    off_centre = np.linalg.norm((p - centre)[:, :2], axis=1)
    lever = np.zeros(len(p))
    if not scene.prismatic:
        joint = scene.fine.joint(scene.joint_name).id
        sweep = np.cross(data.xaxis[joint], p - data.xanchor[joint])
        lever = np.linalg.norm(sweep, axis=1)
        off_centre = np.zeros(len(p))
    score = turn + 2.0 * way + 4.0 * off_centre - 8.0 * lever + 10.0 * clearance
    order = np.argsort(score, kind="stable")
    # Neighbouring places have the same fate: look at different ones first.
    taken: list[int] = []
    for index in order:
        near = any(
            np.linalg.norm(p[index] - p[t]) < 0.02 and abs(np.einsum("ij,ij", R[index], R[t])) > 2.9
            for t in taken
        )
        if not near:
            taken.append(int(index))
        if len(taken) >= 200:
            break
    return np.array(taken)


def _solve(
    scene: Scene,
    world: FineWorld,
    tool: ToolKinematics,
    p: np.ndarray,
    R: np.ndarray,
    clearance_m: float,
    s_target: float,
) -> Hook | None:
    """The place with its joint solutions, or None when the arm cannot be there or would touch something."""
    q = tool.solve(p, R, world.q)
    if q is None:
        return None
    state = world.save()
    s_start = world.s
    try:
        X_part = _part_pose(scene, world)
        p_part = X_part[1].T @ (p - X_part[0])
        if _touches(scene, world, q, s_start):
            return None
        world.data.qpos[scene.s_qpos] = s_target
        mujoco.mj_kinematics(scene.fine, world.data)
        p_end, R_end = _part_pose(scene, world)
        turned = R_end @ X_part[1].T
        q_end = tool.solve(p_end + R_end @ p_part, turned @ R, q)
        if q_end is None or _touches(scene, world, q_end, s_target):
            return None
    finally:
        world.restore(state)
        mujoco.mj_forward(scene.fine, world.data)
    return Hook(p_part, p, R, q, q_end, clearance_m)


def _touches(scene: Scene, world: FineWorld, q: np.ndarray, s: float) -> bool:
    world.data.qpos[: scene.dof] = q
    world.data.qpos[scene.s_qpos] = s
    report = world.check_now()
    return report.contact is not None


def _part_pose(scene: Scene, world: FineWorld) -> tuple[np.ndarray, np.ndarray]:
    body = scene.part_body
    return world.data.xpos[body].copy(), world.data.xmat[body].reshape(3, 3).copy()


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


def _count(batch: mujoco.batch.Batch, poses: np.ndarray) -> np.ndarray:
    qpos, ncon = batch.bind("qpos"), batch.bind("ncon")
    counts = np.zeros(len(poses), dtype=int)
    for start in range(0, len(poses), batch.nsim):
        part = poses[start : start + batch.nsim]
        ids = np.arange(len(part))
        qpos[ids] = part
        batch.forward(ids=ids, stage=int(mujoco.mjtStage.mjSTAGE_POS))
        counts[start : start + len(part)] = np.asarray(ncon)[ids].reshape(-1)
    return counts


def _quat(R: np.ndarray) -> np.ndarray:
    quat_wxyz = np.empty(4)
    mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(R).ravel())
    return quat_wxyz


def _copy_geom(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, model: mujoco.MjModel, geom: int, p: np.ndarray, R: np.ndarray
) -> None:
    """A geom of a compiled model as a geom of another body, at a pose in that body's frame."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    name = model.geom(geom).name or f"geom_{geom}"
    copy = body.add_geom(name=name, type=kind, size=model.geom_size[geom], pos=p, quat=_quat(R.reshape(3, 3)))
    in_hand = body.name == "hand"
    copy.contype, copy.conaffinity = (1, 2) if in_hand else (2, 1)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        mesh_name = f"mesh_{geom}"
        spec.add_mesh(name=mesh_name, uservert=model.mesh_vert[start : start + count].ravel().tolist())
        copy.meshname = mesh_name
