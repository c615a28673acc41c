"""Where the fingertip should push the part: a free place on the side that faces away from the wanted motion.

The paper measures the distance to the part's centre. For a drawer that has to be pulled, the centre lies inside the
front, and the nearest reachable place is in front of the handle, where nothing can be pulled. So a floating copy of
the hand is tried, without physics, at many places around the part: a place is good when the hand is free there, the
fingertip alone meets the part when it goes a little along the part's motion, the hand can back out along its own
axis, and the whole arm has a collision-free joint solution there, both at the start and at the target.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.planning.approach import find_approach
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.free_space import FreeSpace
from s2r_host.planning.hand_probe import HandProbe, quat_of
from s2r_host.planning.kinematics import ToolKinematics
from s2r_host.planning.out_of_reach import OutOfReachError, hull_hint, not_reached, refuse_far
from s2r_host.planning.places import Places, find_places, part_box
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings

logger = logging.getLogger(__name__)

_FUNNEL_M, _FUNNEL_SLOPE = (
    0.05,
    5.0,
)  # height over a place beside it, and how fast that falls towards the place
# Searches in turn, each only where the ones before found too little: points looked at, oblique ways into a gap too,
# places listed. Many points matter between the posts of a short handle; oblique ways cost as much again.
_SEARCHES = ((30, False, 200), (90, False, 200), (500, True, 600))
_ROOMY_M = 0.006  # way to the touch; where some hooks have less, it is worth looking at more places
_FIRST, _RANKED = 24, 40  # places tried first; joint solutions worth a closer look
_SEARCHED = 6  # hooks without a straight way for which one is searched
_ENOUGH = 6  # hooks at which no further joint solutions are looked for
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the part's way, where the arm has to follow it
_FOLLOW = (1.0, 0.0, 0.5)  # shares of a hinge's turn that the tool makes with it, tried in turn
_LARGEST_TURN_RAD = 1.5  # of one joint between them; more is a flip
TOUCH_WAYPOINT = 2  # row of a hook's route at which the fingertip meets the part


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
        approach: Postures on a free way from the start posture to above the place, (k, dof) [rad]; none if the
            straight line there is free.
        axis_part: Axis of a hinge in the part's frame, (3,); zero for a slide.
        s_start: The object's joint at the place.
        follow: Share of a hinge's turn that the tool makes with it.
    """

    p_part: np.ndarray
    R_part_tool: np.ndarray
    push_part: np.ndarray
    q: np.ndarray
    route: np.ndarray
    approach: np.ndarray
    axis_part: np.ndarray
    s_start: float
    follow: float

    @cached_property
    def _directions(self) -> tuple[float, np.ndarray, np.ndarray, float]:
        """Way to the touch [m], unit vectors along it and out along the tool, (3,), and their product."""
        push_m = float(np.linalg.norm(self.push_part))
        ahead, away = self.push_part / push_m, -self.R_part_tool[:, 2]
        return push_m, ahead, away, float(ahead @ away)

    @cached_property
    def _grip_wxyz(self) -> np.ndarray:
        return quat_of(self.R_part_tool)

    @property
    def whole_route(self) -> np.ndarray:
        """Approach and route, (k + m, dof) [rad]."""
        return np.concatenate([self.approach, self.route])

    @property
    def touch_row(self) -> int:
        """Row of the whole route at which the fingertip meets the part."""
        return len(self.approach) + TOUCH_WAYPOINT

    def distance(self, p_tip_part: np.ndarray) -> np.ndarray:
        """Distance [m] that the reward sees, for tool tips in the part's frame (..., 3).

        To the nearest point between the place and the touch, but through a funnel along the axis by which the hand
        can back out: beside the place the fingertip is wanted higher. Straight distance has a minimum in front of
        the handle, where a third of the plans got stuck.
        """
        push_m, ahead, away, level = self._directions
        offset = p_tip_part - self.p_part
        forward = offset @ ahead
        along = np.minimum(np.maximum(forward, 0.0), push_m)
        # What is left of the offset without its share along the push, by its square: this runs for every rollout.
        height = offset @ away - along * level
        squared = np.einsum("...i,...i->...", offset, offset) + along * (along - 2.0 * forward)
        beside = np.sqrt(np.maximum(squared - height**2, 0.0))
        wanted = np.minimum(_FUNNEL_M, _FUNNEL_SLOPE * beside)
        return np.hypot(beside, height - wanted)

    def turn(self, quat_part_wxyz: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Angle [rad] between the tool's orientation in the part (..., 4) and the wanted one at joint value s (...)."""
        grip = self._grip_wxyz
        cosine = quat_part_wxyz @ grip
        if self.follow != 1.0:
            # Wanted is the grip turned about the hinge's axis by the share that the tool does not follow.
            half = -0.5 * (1.0 - self.follow) * (s - self.s_start)
            turned, axis = np.empty(4), np.concatenate([[0.0], self.axis_part])
            mujoco.mju_mulQuat(turned, axis, grip)
            cosine = np.cos(half) * cosine + np.sin(half) * (quat_part_wxyz @ turned)
        return 2.0 * np.arccos(np.minimum(np.abs(cosine), 1.0))


def find_hooks(
    scene: Scene, world: FineWorld, object_mjcf: str | Path, s_target: float, settings: PlanSettings
) -> list[Hook]:
    """Places for the fingertip to move the part from its present state to ``s_target``, best first, at least one.

    Raises:
        OutOfReachError: There is no free place behind the part, or the arm reaches none of them.
    """
    name = Path(object_mjcf).name
    refuse_far(scene, world, name)
    probe = HandProbe(scene, world.data, settings.threads)
    sign = float(np.sign(s_target - world.s))
    why = (
        f"the fingertip fits nowhere behind the part that joint {scene.joint!r} moves towards s = {s_target:.3f}; "
        "is there a gap behind the handle?"
    )
    ways: list[Hook] = []
    for points, oblique, listed in _SEARCHES:
        if oblique and ways:
            break
        places = find_places(scene, world.data, probe, sign, points, oblique=oblique)
        if not len(places):
            continue
        solver = _Solver(scene, world, places, s_target, settings)
        order = _different(places, np.argsort(_scores(scene, world.data, places), kind="stable"), listed)
        hooks = _cheapest(scene, world, solver, places, order)
        ways = solver.with_approach(_apart(hooks), settings.hooks) or ways
        if len(ways) >= settings.hooks and all(np.linalg.norm(way.push_part) >= _ROOMY_M for way in ways):
            break
        why = not_reached(scene, places, solver.failure(len(order), len(hooks), s_target))
    if not ways:
        raise OutOfReachError(f"object {name}: {why}{hull_hint(scene)}")
    return ways


def _cheapest(
    scene: Scene, world: FineWorld, solver: _Solver, places: Places, order: np.ndarray
) -> list[Hook]:
    """Hooks at the places in the given order, the cheapest first; a few of them, if it has that many."""
    found: list[tuple[float, Hook]] = []
    first, rest = order[:_FIRST], order[_FIRST:]
    for some, seeds in ((first, _near_seeds), (rest, _near_seeds), (order, _far_seeds)):
        if len(some):
            found += solver.hooks(some, seeds(scene, world.q, places.p[some]))
        if len(found) >= _ENOUGH:
            break
    found.sort(key=lambda entry: entry[0])
    logger.debug("%d joint solutions at %d places", len(found), len(order))
    return [hook for _, hook in found[:_RANKED]]


class _Solver:
    """Joint solutions of the whole arm at places: free now, free at the target, and along with the part between."""

    def __init__(
        self, scene: Scene, world: FineWorld, places: Places, s_target: float, settings: PlanSettings
    ) -> None:
        self._scene, self._q, self._s, self._s_target = scene, world.q, world.s, s_target
        self._places = places
        self._tool = ToolKinematics(scene, settings.joint_margin_rad, settings.threads)
        self._space = FreeSpace(scene, settings.threads)
        self._tightness = _tightness(places)
        self._part = [_part_pose_at(scene, world, self._s + k * (s_target - self._s)) for k in _SHARES]
        joint = scene.joint_id
        hinge = 0.0 if scene.prismatic else 1.0
        self._axis_world = hinge * world.data.xaxis[joint]
        self._axis_part = hinge * scene.fine.jnt_axis[joint]
        self._reached = self._free = self._followed = 0

    def hooks(self, order: np.ndarray, seeds: list[np.ndarray]) -> list[tuple[float, Hook]]:
        """Hooks and their costs; every array of seeds is (places in order, dof)."""
        index = np.tile(order, len(seeds))
        p, R = self._places.p[index], self._places.R[index]
        q, good = self._tool.solve_many(p, R, np.concatenate(seeds))
        index, p, R, q = index[good], p[good], R[good], q[good]
        self._reached += len(q)
        free = self._space.contacts(q, self._s) == 0
        index, p, R, q = index[free], p[free], R[free], q[free]
        self._free += len(q)
        p_start, R_start = self._part[0]
        p_part, R_part_tool = (p - p_start) @ R_start, R_start.T @ R
        push_part = (self._places.push_m[index, None] * self._places.way[index]) @ R_start
        above, has_above = self._tool.solve_many(p - _FUNNEL_M * R[:, :, 2], R, q)
        above[~has_above] = q[~has_above]
        follow, route = np.full(len(q), np.nan), np.empty((2 + len(_SHARES), *q.shape))
        route[0], route[1] = above, q
        for share in (1.0,) if self._scene.prismatic else _FOLLOW:
            left = np.flatnonzero(np.isnan(follow))
            ok, ways = self._follow(p_part[left], push_part[left], R_part_tool[left], q[left], share)
            follow[left[ok]] = share
            route[2:, left[ok]] = ways[:, ok]
        rows = np.flatnonzero(np.isfinite(follow))
        self._followed += len(rows)
        if not len(rows):
            return []
        blocked = self._space.blocked_share(self._q, above[rows], self._s, count=6)
        travel = np.abs(q[rows] - self._q).max(axis=1) + 0.5 * np.abs(route[-1] - q)[rows].max(axis=1)
        costs = travel + self._tightness[index[rows]] + 4.0 * blocked
        return [
            (
                float(cost),
                Hook(
                    p_part[i], R_part_tool[i], push_part[i], q[i], route[:, i],
                    np.zeros((0, self._scene.dof)), self._axis_part, self._s, follow[i],
                ),
            )
            for i, cost in zip(rows, costs, strict=True)
        ]  # fmt: skip

    def with_approach(self, hooks: list[Hook], most: int) -> list[Hook]:
        """Hooks that the arm has a free way to, with that way, in the given order; only so many are looked for."""
        found: list[Hook] = []
        searched = 0
        for hook in hooks:
            if len(found) >= most or searched >= _SEARCHED:
                break
            descent_free = self._space.path_is_free(hook.route[:2], self._s)
            if descent_free and self._space.path_is_free(np.array([self._q, hook.route[0]]), self._s):
                found.append(hook)
                continue
            searched += 1
            goal = hook.route[0] if descent_free else hook.q
            way = find_approach(self._scene, self._space, self._q, goal, self._s)
            if way is not None:
                route = hook.route if descent_free else np.concatenate([hook.q[None], hook.route[1:]])
                found.append(replace(hook, approach=way[1:-1], route=route))
        return found

    def _follow(
        self, p_part: np.ndarray, push_part: np.ndarray, R_part_tool: np.ndarray, q: np.ndarray, share: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which fingertips can go with the part from the touch to the target, bool (n,), and how, (waypoints, n, dof).

        ``share`` of a hinge's turn is made by the tool as well; at the end of a slide it must be free to let go.
        """
        route, ok = [q], np.ones(len(q), dtype=bool)
        _, R_start = self._part[0]
        R_tool = R_part_tool
        for (p_now, R_now), way in zip(self._part, _SHARES, strict=True):
            s = self._s + way * (self._s_target - self._s)
            R_tool = self._turned(share * (s - self._s)) @ R_start @ R_part_tool
            reached, good = self._tool.solve_many(p_now + (p_part + push_part) @ R_now.T, R_tool, route[-1])
            ok &= good & (np.abs(reached - route[-1]).max(axis=1, initial=0.0) < _LARGEST_TURN_RAD)
            ok &= self._space.contacts(reached, s, touching=True) == 0
            route.append(reached)
        if not self._scene.prismatic:
            return ok, np.array(route[1:])  # a turned finger touches the part on both sides of a narrow gap
        p_end, R_end = self._part[-1]
        q_end, good = self._tool.solve_many(p_end + p_part @ R_end.T, R_tool, route[-1])
        ok &= good & (self._space.contacts(q_end, self._s_target) == 0)
        return ok, np.array(route[1:])

    def _turned(self, angle_rad: float) -> np.ndarray:
        """Rotation by an angle about the hinge's axis in the world, (3, 3)."""
        quat_wxyz, R = np.empty(4), np.empty(9)
        mujoco.mju_axisAngle2Quat(quat_wxyz, self._axis_world, angle_rad)
        mujoco.mju_quat2Mat(R, quat_wxyz)
        return R.reshape(3, 3)

    def failure(self, count: int, followed: int, s_target: float) -> str:
        """Why there is no way to a hook, for the middle of a sentence."""
        if followed:
            return f"finds no free way to {followed} postures at places behind the part"
        if not self._reached:
            return f"reaches none of {count} places behind the part"
        if not self._free:
            return f"touches something at each of {count} places behind the part that it reaches"
        return f"can be at places behind the part, but cannot follow it from there to s = {s_target:.3f}"


def _near_seeds(scene: Scene, q: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
    """Starts of the inverse kinematics: where the arm is, and its home turned towards the place."""
    here = np.tile(q, (len(p), 1))
    turned = np.tile(scene.arm.q_home, (len(p), 1))
    turned[:, 0] = np.arctan2(p[:, 1], p[:, 0])
    return [here, turned]


def _far_seeds(scene: Scene, q: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
    """More starts, of other postures: the middle of the range and a few by chance, always the same."""
    limits = scene.arm.limits
    rng = np.random.default_rng(0)
    seeds = [np.tile(0.5 * (limits.q_min + limits.q_max), (len(p), 1))]
    seeds += [rng.uniform(0.7 * limits.q_min, 0.7 * limits.q_max, (len(p), scene.dof)) for _ in range(3)]
    for seed in seeds:
        seed[:, 0] = np.arctan2(p[:, 1], p[:, 0])
    return seeds


def _apart(hooks: list[Hook]) -> list[Hook]:
    """The hooks in an order in which the first few are not neighbours of each other."""
    first, later = [], []
    for hook in hooks:
        near = any(
            np.linalg.norm(hook.p_part - other.p_part) < 0.015 and np.abs(hook.q - other.q).max() < 0.5
            for other in first
        )
        (later if near else first).append(hook)
    return first + later


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
        leverage = -8.0 * scene.lever(data, places.p)
    return turn + 2.0 * way + leverage + _tightness(places)


def _different(places: Places, order: np.ndarray, most: int) -> np.ndarray:
    """The order without places that are nearly the same as an earlier one: neighbours share their fate."""
    p, R = places.p[order], places.R[order].reshape(-1, 9)
    left = np.arange(len(order))
    taken: list[int] = []
    while len(left) and len(taken) < most:
        first, left = left[0], left[1:]
        taken.append(int(order[first]))
        near = np.square(p[left] - p[first]).sum(axis=1) < 0.02**2
        alike = R[left] @ R[first] > 2.9
        left = left[~(near & alike)]
    return np.array(taken, dtype=int)


def _part_pose_at(scene: Scene, world: FineWorld, s: float) -> tuple[np.ndarray, np.ndarray]:
    data = mujoco.MjData(scene.fine)
    data.qpos[:] = world.data.qpos
    data.qpos[scene.s_qpos] = s
    mujoco.mj_kinematics(scene.fine, data)
    return data.xpos[scene.part_body].copy(), data.xmat[scene.part_body].reshape(3, 3).copy()
