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
import numpy as np

from s2r_host.errors import HostError
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hand_probe import HandProbe, quat_of
from s2r_host.planning.kinematics import ToolKinematics
from s2r_host.planning.places import Places, find_places, part_box
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings
from s2r_protocol.exits import RefusedError

logger = logging.getLogger(__name__)

_FUNNEL_M, _FUNNEL_SLOPE = (
    0.05,
    5.0,
)  # height over a place beside it, and how fast that falls towards the place
_LISTED = 200
TOUCH_WAYPOINT = 2  # row of a hook's route at which the fingertip meets the part


class OutOfReachError(HostError, RefusedError):
    """The arm cannot get its fingertip to where the part could be pushed."""


@dataclass(frozen=True, eq=False)
class Hook:
    """A place for the fingertip.

    Attributes:
        p_part: Tool tip in the part's frame [m], (3,).
        R_part_tool: Orientation of the tool there in the part's frame, (3, 3).
        push_part: From there to where the fingertip meets the part, along the part's motion, part frame [m], (3,).
        q: Joint solution there [rad], (dof,).
        route: Joint solutions above the place, at the place, at the touch, and on with the part to the target,
            (m, dof) [rad]. Only a proposal for the sampler.
    """

    p_part: np.ndarray
    R_part_tool: np.ndarray
    push_part: np.ndarray
    q: np.ndarray
    route: np.ndarray

    def distance(self, p_tip_part: np.ndarray) -> np.ndarray:
        """Distance [m] that the reward sees, for tool tips in the part's frame (..., 3).

        To the nearest point between the place and the touch, but through a funnel along the axis by which the hand
        can back out: beside the place the fingertip is wanted higher. Straight distance has a minimum in front of
        the handle, where a third of the plans got stuck.
        """
        push_m = float(np.linalg.norm(self.push_part))
        ahead = self.push_part / push_m
        away = -self.R_part_tool[:, 2]
        offset = p_tip_part - self.p_part
        along = np.clip(offset @ ahead, 0.0, push_m)
        offset = offset - along[..., None] * ahead
        height = offset @ away
        beside = np.linalg.norm(offset - height[..., None] * away, axis=-1)
        wanted = np.minimum(_FUNNEL_M, _FUNNEL_SLOPE * beside)
        return np.hypot(beside, height - wanted)

    def turn(self, quat_part_wxyz: np.ndarray) -> np.ndarray:
        """Angle [rad] between the tool's orientation (..., 4) and the one it has here."""
        cosine = np.abs(quat_part_wxyz @ quat_of(self.R_part_tool))
        return 2.0 * np.arccos(np.minimum(cosine, 1.0))


def find_hooks(
    scene: Scene, world: FineWorld, object_mjcf: str | Path, s_target: float, settings: PlanSettings
) -> list[Hook]:
    """Places for the fingertip to move the part from its present state to ``s_target``, best first, at least one.

    Raises:
        OutOfReachError: There is no free place behind the part, or the arm reaches none of them.
    """
    name = Path(object_mjcf).name
    probe = HandProbe(scene, world.data, settings.threads)
    places = find_places(scene, world.data, probe, float(np.sign(s_target - world.s)))
    if not len(places):
        raise OutOfReachError(
            f"object {name}: the fingertip fits nowhere behind the part that joint {scene.joint!r} moves "
            f"towards s = {s_target:.3f}; is there a gap behind the handle?"
        )
    scores = _scores(scene, world.data, places)
    order = _different(places, np.argsort(scores, kind="stable"))[: settings.hooks]
    tool = ToolKinematics(scene, settings.joint_margin_rad)
    tightness = _tightness(places)
    found: list[tuple[float, Hook]] = []
    for index in order:
        hook = _solve(scene, world, tool, places, int(index), s_target)
        if hook is not None:
            travel = np.abs(hook.q - world.q).max() + 0.5 * np.abs(hook.route[-1] - hook.q).max()
            found.append((float(travel + tightness[index]), hook))
    if not found:
        raise OutOfReachError(
            f"object {name}: out of reach: the arm {scene.arm.name!r} has no collision-free joint solution at any of "
            f"{len(order)} places behind the part (nearest {np.linalg.norm(places.p, axis=1).min():.2f} m from the "
            f"base) both now and at s = {s_target:.3f}; move the object"
        )
    found.sort(key=lambda entry: entry[0])
    logger.debug("%d of %d places have joint solutions", len(found), len(places))
    return [hook for _, hook in found]


def _tightness(places: Places) -> np.ndarray:
    """Cost of places that leave little room or are far from the touch, (n,), in units of radians of travel.

    Room towards the part counts most: a fingertip that comes down within a few millimetres of an edge lands on it
    when the object stands a little nearer than believed, and jams there.
    """
    near, far = np.maximum(0.012 - places.push_m, 0.0), np.maximum(places.push_m - 0.016, 0.0)
    return 0.2 * places.blocked + 150.0 * near + 5.0 * far


def _scores(scene: Scene, data: mujoco.MjData, places: Places) -> np.ndarray:
    """Cost before any inverse kinematics, (n,): turning, way, tightness, off-centre for slides, short levers."""
    p_now = data.site_xpos[scene.tool_site]
    R_now = data.site_xmat[scene.tool_site].reshape(3, 3)
    cosine = (np.einsum("nij,ij->n", places.R, R_now) - 1.0) / 2.0
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    way = np.linalg.norm(places.p - p_now, axis=1)
    if scene.prismatic:
        low, high = part_box(scene, data)
        centre = (low + high)[:2] / 2.0
        leverage = 4.0 * np.linalg.norm(places.p[:, :2] - centre, axis=1)
    else:
        joint = scene.fine.joint(scene.joint_name).id
        leverage = -8.0 * np.linalg.norm(np.cross(data.xaxis[joint], places.p - data.xanchor[joint]), axis=1)
    return turn + 2.0 * way + leverage + _tightness(places)


def _different(places: Places, order: np.ndarray) -> np.ndarray:
    """The order without places that are nearly the same as an earlier one: neighbours share their fate."""
    taken: list[int] = []
    for index in order:
        near = np.linalg.norm(places.p[taken] - places.p[index], axis=1) < 0.02
        alike = np.einsum("nij,ij->n", places.R[taken], places.R[index]) > 2.9
        if not (near & alike).any():
            taken.append(int(index))
        if len(taken) >= _LISTED:
            break
    return np.array(taken)


def _solve(
    scene: Scene, world: FineWorld, tool: ToolKinematics, places: Places, index: int, s_target: float
) -> Hook | None:
    """The place with its joint solutions, or None when the arm cannot be there or would touch something."""
    p, R = places.p[index], places.R[index]
    q = tool.solve(p, R, world.q)
    if q is None:
        return None
    state, s_start = world.save(), world.s
    try:
        p_start, R_start = _part_pose(scene, world)
        if _touches(scene, world, q, s_start):
            return None
        p_part, R_part_tool = R_start.T @ (p - p_start), R_start.T @ R
        push_part = R_start.T @ (places.push_m[index] * places.way[index])
        above = tool.solve(p - _FUNNEL_M * R[:, 2], R, q)
        route = [q if above is None else above, q]
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            p_now, R_now = _part_pose_at(scene, world, s_start + share * (s_target - s_start))
            reached = tool.solve(p_now + R_now @ (p_part + push_part), R_now @ R_part_tool, route[-1])
            if reached is None:
                return None
            route.append(reached)
        q_end = tool.solve(p_now + R_now @ p_part, R_now @ R_part_tool, route[-1])
        if q_end is None or _touches(scene, world, q_end, s_target):
            return None
    finally:
        world.restore(state)
        mujoco.mj_forward(scene.fine, world.data)
    return Hook(p_part, R_part_tool, push_part, q, np.array(route))


def _touches(scene: Scene, world: FineWorld, q: np.ndarray, s: float) -> bool:
    world.data.qpos[: scene.dof] = q
    world.data.qpos[scene.s_qpos] = s
    return world.check_now().contact is not None


def _part_pose(scene: Scene, world: FineWorld) -> tuple[np.ndarray, np.ndarray]:
    body = scene.part_body
    return world.data.xpos[body].copy(), world.data.xmat[body].reshape(3, 3).copy()


def _part_pose_at(scene: Scene, world: FineWorld, s: float) -> tuple[np.ndarray, np.ndarray]:
    world.data.qpos[scene.s_qpos] = s
    mujoco.mj_kinematics(scene.fine, world.data)
    return _part_pose(scene, world)
