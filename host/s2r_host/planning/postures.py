"""Postures of the whole arm at places behind a part, and along with it to where it shall go."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from s2r_host.planning.approach import find_approach
from s2r_host.planning.effort import Resistance, efforts
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.free_space import FINE_STEP_RAD, FreeSpace
from s2r_host.planning.hook import FUNNEL_M, Hook
from s2r_host.planning.kinematics import ToolKinematics
from s2r_host.planning.places import Places, gain_of_proven, in_world, tightness
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings

_SEARCHED = 6  # hooks without a straight way for which one is searched
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the part's way, where the arm has to follow it
_FOLLOW = (1.0, 0.0, 0.5)  # shares of a hinge's turn that the tool makes with it, tried in turn
_STEPS_NEAR = 6  # iterations from a neighbouring posture
_LARGEST_TURN_RAD = 1.5  # of one joint between them; more is a flip
_NEARER_M = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3)  # how much nearer an object out of reach is thought to stand
_LEAST_M = 1e-6  # what stands on the base's own axis is not nearer anywhere
_EASY, _EFFORT = (
    0.15,
    10.0,
)  # share of a joint's torque limit that costs nothing; cost of all of it beyond [rad]


class Postures:
    """Joint solutions of the whole arm at places: free now, free at the target, and along with the part between."""

    def __init__(
        self,
        scene: Scene,
        world: FineWorld,
        s_target: float,
        settings: PlanSettings,
        *,
        leave: bool = False,
        apart_m: float = 0.0,
        rims: bool = False,
    ) -> None:
        """Args: ``leave``, also free to let go at the target; ``apart_m``, what is nearer to the robot is touched;
        ``rims``, clear of wherever the part may reach to."""
        self._leave = leave
        self._scene, self._q, self._s, self._s_target = scene, world.q, world.s, s_target
        self._tool = ToolKinematics(scene, settings.joint_margin_rad, settings.threads)
        self._space = FreeSpace(scene, settings.threads, apart_m, world.others, rims=rims)
        self._room_m = settings.room_m
        self._missed = in_world(scene, world.data, settings.missed)
        self._proven = in_world(scene, world.data, settings.proven)
        self._pose_data = mujoco.MjData(scene.fine)
        self._pose_data.qpos[:] = world.data.qpos
        self._part = [self._part_pose_at(self._s + k * (s_target - self._s)) for k in _SHARES]
        joint = scene.joint_id
        hinge = 0.0 if scene.prismatic else 1.0
        self._axis_world = hinge * world.data.xaxis[joint]
        self._axis_part = hinge * scene.fine.jnt_axis[joint]
        states = [self._s + k * (s_target - self._s) for k in _SHARES]
        self._resistance = Resistance(scene, world, states, float(np.sign(s_target - self._s)))
        self._reached = self._free = self._followed = 0

    def hooks(self, places: Places, seeds: list[np.ndarray]) -> list[tuple[float, Hook]]:
        """Hooks at places and their costs; every array of seeds is (places, dof)."""
        if not len(places):
            return []
        at, q = self._free_solutions(places, seeds)
        p, R = at.p, at.R
        p_part, R_part_tool, push_part = self._in_part(at)
        above, has_above = self._tool.solve_many(p - FUNNEL_M * R[:, :, 2], R, q, _STEPS_NEAR)
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
        effort = efforts(self._tool, self._resistance, route[2:, rows], self._scene.arm.limits.tau_max)
        costs = (
            travel
            + tightness(at, self._room_m, self._missed)[rows]
            - gain_of_proven(at.p, at.way, self._proven)[rows]
            + 4.0 * blocked
            + _EFFORT * np.maximum(effort - _EASY, 0.0)
        )
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

    def _free_solutions(self, places: Places, seeds: list[np.ndarray]) -> tuple[Places, np.ndarray]:
        """Joint solutions without contact, (n, dof), and the places they are at; a place may come several times."""
        at = places.at(np.tile(np.arange(len(places)), len(seeds)))
        q, good = self._tool.solve_many(at.p, at.R, np.concatenate(seeds))
        at, q = at.at(good), q[good]
        self._reached += len(q)
        free = ~self._space.touches(q, self._s)
        at, q = at.at(free), q[free]
        self._free += len(q)
        return at, q

    def _in_part(self, places: Places) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tool tips (n, 3), orientations (n, 3, 3) and ways to the touch (n, 3) of places, in the part's frame."""
        p_start, R_start = self._part[0]
        push_part = (places.push_m[:, None] * places.way) @ R_start
        return (places.p - p_start) @ R_start, R_start.T @ places.R, push_part

    def carried(self, places: Places, seeds: list[np.ndarray], s_steps: np.ndarray) -> np.ndarray:
        """How many fingertips can carry the part to each of the states in turn and let go of it there, (len(s_steps),).

        Args:
            places: Where they begin.
            seeds: Starts of the inverse kinematics, (places, dof) each.
            s_steps: Joint values on the way, growing away from the present one.
        """
        at, q_start = self._free_solutions(places, seeds)
        p_part, R_part_tool, push_part = self._in_part(at)
        counts = np.zeros(len(s_steps), dtype=int)
        for share in (1.0,) if self._scene.prismatic else _FOLLOW:
            left, q = np.arange(len(at)), q_start
            for step, s in enumerate(s_steps):
                pose = self._part_pose_at(s)
                R_tool = self._turned(share * (s - self._s)) @ self._part[0][1] @ R_part_tool[left]
                ok, q = self._at(pose, s, p_part[left] + push_part[left], R_tool, q)
                left, q, R_tool = left[ok], q[ok], R_tool[ok]
                if not len(left):
                    break
                counts[step] += self._lets_go(pose, s, p_part[left], R_tool, q).sum()
        return counts

    def _at(
        self,
        pose: tuple[np.ndarray, np.ndarray],
        s: float,
        p_part: np.ndarray,
        R_tool: np.ndarray,
        q: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Whether the arm goes on from postures q (n, dof) to points of the part at a pose of it, (n,); and there."""
        p_now, R_now = pose
        reached, ok = self._tool.solve_many(p_now + p_part @ R_now.T, R_tool, q, _STEPS_NEAR)
        ok = ok & (np.abs(reached - q).max(axis=1, initial=0.0) < _LARGEST_TURN_RAD)
        return ok & ~self._space.touches(reached, s, touching=True), reached

    def _lets_go(
        self,
        pose: tuple[np.ndarray, np.ndarray],
        s: float,
        p_part: np.ndarray,
        R_tool: np.ndarray,
        q: np.ndarray,
    ) -> np.ndarray:
        """Whether the fingertip is free when it goes back to its place beside the part, and can back out, (n,)."""
        p_now, R_now = pose
        beside, ok = self._tool.solve_many(p_now + p_part @ R_now.T, R_tool, q, _STEPS_NEAR)
        ok = ok & ~self._space.touches(beside, s)
        out, good = self._tool.solve_many(
            p_now + p_part @ R_now.T - FUNNEL_M * R_tool[:, :, 2], R_tool, beside, _STEPS_NEAR
        )
        return ok & good & ~self._space.touches(out, s)

    def with_approach(self, hooks: list[Hook], most: int) -> list[Hook]:
        """Hooks that the arm has a free way to, with that way, in the given order; only so many are looked for."""
        found: list[Hook] = []
        searched = 0
        for hook in hooks:
            if len(found) >= most or searched >= _SEARCHED:
                break
            descent_free = self._is_free(hook.route[:2])
            if descent_free and self._is_free(np.array([self._q, hook.route[0]])):
                found.append(hook)
                continue
            searched += 1
            goal = hook.route[0] if descent_free else hook.q
            way = find_approach(self._scene, self._space, self._q, goal, self._s)
            if way is not None:
                route = hook.route if descent_free else np.concatenate([hook.q[None], hook.route[1:]])
                found.append(replace(hook, approach=way[1:-1], route=route))
        return found

    def _is_free(self, q_path: np.ndarray) -> bool:
        """A coarse look first: most ways that are blocked are blocked there."""
        space, s = self._space, self._s
        return space.path_is_free(q_path, s) and space.path_is_free(q_path, s, FINE_STEP_RAD)

    def _follow(
        self, p_part: np.ndarray, push_part: np.ndarray, R_part_tool: np.ndarray, q: np.ndarray, share: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which fingertips can go with the part from the touch to the target, bool (n,), and how, (waypoints, n, dof).

        ``share`` of a hinge's turn is made by the tool as well; at the end of a slide it must be free to let go.
        """
        left, ways = np.arange(len(q)), np.empty((len(_SHARES), *q.shape))
        _, R_start = self._part[0]
        R_tool = R_part_tool
        for step, (pose, way) in enumerate(zip(self._part, _SHARES, strict=True)):
            s = self._s + way * (self._s_target - self._s)
            R_tool = self._turned(share * (s - self._s)) @ R_start @ R_part_tool[left]
            good, q = self._at(pose, s, (p_part + push_part)[left], R_tool, q)
            left, q, R_tool = left[good], q[good], R_tool[good]
            ways[step, left] = q
        if self._leave:
            good = self._lets_go(self._part[-1], self._s_target, p_part[left], R_tool, q)
            left, q, R_tool = left[good], q[good], R_tool[good]
        if self._scene.prismatic:  # a turned finger touches the part on both sides of a narrow gap
            p_end, R_end = self._part[-1]
            q_end, good = self._tool.solve_many(p_end + p_part[left] @ R_end.T, R_tool, q, _STEPS_NEAR)
            left = left[good & ~self._space.touches(q_end, self._s_target)]
        ok = np.zeros(len(p_part), dtype=bool)
        ok[left] = True
        return ok, ways

    def _turned(self, angle_rad: float) -> np.ndarray:
        """Rotation by an angle about the hinge's axis in the world, (3, 3)."""
        quat_wxyz, R = np.empty(4), np.empty(9)
        mujoco.mju_axisAngle2Quat(quat_wxyz, self._axis_world, angle_rad)
        mujoco.mju_quat2Mat(R, quat_wxyz)
        return R.reshape(3, 3)

    def _part_pose_at(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and rotation (3, 3) of the part in the world at joint value s."""
        data, part = self._pose_data, self._scene.part_body
        data.qpos[self._scene.s_qpos] = s
        mujoco.mj_kinematics(self._scene.fine, data)
        return data.xpos[part].copy(), data.xmat[part].reshape(3, 3).copy()

    def failure(self, count: int, followed: int, s_target: float) -> str:
        """Why there is no way to a hook, for the middle of a sentence."""
        if followed:
            return f"finds no free way to {followed} postures at places behind the part"
        if not self._reached:
            return f"reaches none of {count} places behind the part"
        if not self._free:
            return f"touches something at each of {count} places behind the part that it reaches"
        return f"can be at places behind the part, but cannot follow it from there to s = {s_target:.3f}"

    def nearer_m(self, places: Places) -> float | None:
        """How much nearer to the base the places would have to be for the arm to reach one of them, in steps [m].

        None: it reaches one where they are, or none of these steps helps.
        """
        if self._reached or not len(places):
            return None
        level = places.p * (1.0, 1.0, 0.0)
        towards = -level / np.maximum(np.linalg.norm(level, axis=1, keepdims=True), _LEAST_M)
        for step in _NEARER_M:
            p = places.p + step * towards
            for q in [*near_seeds(self._scene, self._q, p), *far_seeds(self._scene, p)]:
                if self._tool.solve_many(p, places.R, q)[1].any():
                    return step
        return None


def near_seeds(scene: Scene, q: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
    """Starts of the inverse kinematics: where the arm is, and its home turned towards the place."""
    here = np.tile(q, (len(p), 1))
    turned = np.tile(scene.arm.q_home, (len(p), 1))
    turned[:, 0] = np.arctan2(p[:, 1], p[:, 0])
    return [here, turned]


def far_seeds(scene: Scene, p: np.ndarray) -> list[np.ndarray]:
    """More starts, of other postures: the middle of the range and a few by chance, always the same."""
    limits = scene.arm.limits
    rng = np.random.default_rng(0)
    seeds = [np.tile(0.5 * (limits.q_min + limits.q_max), (len(p), 1))]
    seeds += [rng.uniform(0.7 * limits.q_min, 0.7 * limits.q_max, (len(p), scene.dof)) for _ in range(3)]
    for seed in seeds:
        seed[:, 0] = np.arctan2(p[:, 1], p[:, 0])
    return seeds
