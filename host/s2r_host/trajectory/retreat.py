"""Letting go of a part that stays where it is: off the contact, then out, played in the fine model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.free_space import FreeSpace
from s2r_host.planning.kinematics import ToolKinematics
from s2r_host.planning.planner import world_of
from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRefusedError, PlanRequest
from s2r_host.trajectory.time_law import TimeLawSettings, time_law
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError
from s2r_host.trajectory.verify import servo_targets

_BACK_M = (0.006, 0.010, 0.015, 0.004, 0.022, 0.030)  # against the part's motion, until nothing is touched
_OUT_M = (0.14, 0.10, 0.07, 0.05, 0.03)
_STEP_M = 0.01  # between postures of a straight way
_FARTHEST_RAD = 0.3  # of a joint between them; more is a flip
_SPEED = 0.5  # share of the time law's speed: the part shall stay where it is
_TRIED = 12  # ways out that the fine model is asked about
_STAYS = 5.0  # success bands that a part may move while it is let go of
_KNOTS = 120


@dataclass(frozen=True, eq=False)
class Retreat:
    """The way out, and what the fine model then has.

    Attributes:
        trajectory: From the end of the motion before, at rest, to a posture free of the part, at rest.
        q: That posture [rad], (dof,).
        s: The object's joint after it.
        others: Positions of everything besides the arm, (nq - dof,).
    """

    trajectory: Trajectory
    q: np.ndarray
    s: float
    others: np.ndarray


def retreat(motion: Trajectory, request: PlanRequest, scene: Scene) -> Retreat:
    """Leave the part at the end of a motion that moved it.

    Args:
        motion: Played from where the request begins, and held at its end as a replay does.
        request: The task of that motion.
        scene: Its scene.

    Raises:
        PlanRefusedError: No way out is free, or the part does not stay; the text says which.
    """
    settings = request.settings
    world = world_of(request, scene)
    world.play(servo_targets(motion, request)[1])
    end, s_end = world.save(), world.s
    tolerance = settings.tolerance_m if scene.prismatic else settings.tolerance_rad
    unit = "m" if scene.prismatic else "rad"
    timing = TimeLawSettings(speed=_SPEED, max_knots=_KNOTS)
    problem = "every way off the part is blocked"
    for tried, path in enumerate(_ways_out(world, motion.q[-1], request, scene)):
        if tried == _TRIED:
            break
        try:
            trajectory = time_law(path, request.arm, timing, gravity=scene.gravity)
        except TrajectoryError as error:
            problem = str(error)
            continue
        near = scene.links.near(trajectory.q)
        if near is not None:
            problem = f"on the way out {near}"
            continue
        world.restore(end)
        control = servo_targets(trajectory, replace(request, q_initial=path[0]))[1]
        standing = round(settings.hold_s / settings.fine_timestep_s)
        report = world.play(control[:-standing])
        s_free = world.s
        report = report.merged(world.play(control[-standing:]))
        if report.contact is not None:
            problem = f"on the way out it touches something unexpected: {report.contact}"
        elif report.press_N > settings.press_max_N:
            problem = f"on the way out it presses on the part with {report.press_N:.0f} N across its motion"
        elif world.check_now().touched:
            problem = "the fingertip does not come free of the part"
        elif max(abs(world.s - s_end), abs(world.s - s_free)) > _STAYS * tolerance:
            problem = f"the part does not stay: let go of, it goes from {s_end:.4f} to {world.s:.4f} {unit}"
        else:
            return Retreat(trajectory, trajectory.q[-1].copy(), world.s, world.others)
    raise PlanRefusedError(f"the part cannot be left at s = {s_end:.4f} {unit}: {problem}")


def _ways_out(
    world: FineWorld, q_end: np.ndarray, request: PlanRequest, scene: Scene
) -> Iterator[np.ndarray]:
    """Joint paths (n, dof) off the contact, which may touch, and on out, which do not; the most natural ones first."""
    settings, s = request.settings, world.s
    tool = ToolKinematics(scene, settings.joint_margin_rad, settings.threads)
    space = FreeSpace(scene, settings.threads, others=world.others)
    p, R = tool.pose(q_end)
    back = -np.sign(request.s_target - request.s_initial) * scene.part_motion(world.data, p)
    axis = R[:, 2]
    directions = (-axis, back, back - axis, R[:, 0], -R[:, 0], R[:, 1], -R[:, 1])
    # Longest ways first for every direction: a short one leaves the hand in a corner.
    for out_m in _OUT_M:
        for back_m in _BACK_M:
            off = _straight(tool, q_end, p, p + back_m * back, R)
            if off is None or space.touches(off[-1:], s)[0]:
                continue
            for direction in directions:
                unit = direction / np.linalg.norm(direction)
                out = _straight(tool, off[-1], p + back_m * back, p + back_m * back + out_m * unit, R)
                if out is not None and space.path_is_free(out, s):
                    yield np.concatenate([off, out[1:]])


def _straight(
    tool: ToolKinematics, q_start: np.ndarray, p_from: np.ndarray, p_to: np.ndarray, R: np.ndarray
) -> np.ndarray | None:
    """Postures along a straight line of the tool without turning it, (n, dof), or None where the arm cannot follow."""
    count = max(1, int(np.ceil(np.linalg.norm(p_to - p_from) / _STEP_M)))
    path = [np.asarray(q_start, dtype=float)]
    for share in np.arange(1, count + 1) / count:
        q = tool.solve(p_from + share * (p_to - p_from), R, path[-1])
        if q is None or np.abs(q - path[-1]).max() > _FARTHEST_RAD:
            return None
        path.append(q)
    return np.array(path)
