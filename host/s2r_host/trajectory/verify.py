"""Replay of a timed trajectory in the fine model: where the object ends and what happens on the way."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from s2r_host.planning.execution import Report, play_side_by_side
from s2r_host.planning.planner import scene_of, world_of
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings
from s2r_host.planning.task import PlanRequest
from s2r_host.trajectory.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Replay:
    """What the fine model did with a timed trajectory.

    Attributes:
        t: Times [s], (m,), from the start to the end of the hold.
        s: The object's joint then, (m,).
        q_meas: The arm's joints then [rad], (m, dof).
        final: The object's joint at the end of the hold.
        error: ``s_target - final``.
        hold_range: Smallest and largest value of the joint during the hold. A lid on a soft friction creeps.
        held: During the hold the joint stayed within two success bands of the target.
        contact: First contact that was not fingertip against part, or None.
        touched: The fingertip touched the part.
        torque_share: Largest torque over its limit.
        torque_joint: Name of that joint.
        press_N: Largest force of the fingertip on the part across the part's motion.
        contact_share: Largest joint torque that contact causes, over the joint's limit.
    """

    t: np.ndarray
    s: np.ndarray
    q_meas: np.ndarray
    final: float
    error: float
    hold_range: tuple[float, float]
    held: bool
    contact: str | None
    touched: bool
    torque_share: float
    torque_joint: str
    press_N: float
    contact_share: float

    @property
    def offset(self) -> float:
        """``s_target`` minus the middle of the hold's range: what a correction should add."""
        return self.error + self.final - sum(self.hold_range) / 2.0

    def problem(self, tolerance: float, settings: PlanSettings) -> str | None:
        """Why the trajectory may not be delivered, in one sentence, or None."""
        if self.contact is not None:
            return f"the timed motion touches something unexpected: {self.contact}"
        if self.torque_share > settings.torque_margin:
            return f"joint {self.torque_joint!r}: the timed motion takes {self.torque_share:.0%} of its torque limit"
        if self.press_N > settings.press_max_N:
            return (
                f"the timed motion presses on the part with {self.press_N:.0f} N across its motion, "
                f"limit {settings.press_max_N:.0f} N"
            )
        if abs(self.offset) >= tolerance:
            return f"the timed motion ends at s = {self.final:.4f}, {self.error:+.4f} from the target"
        if not self.held:
            return (
                f"the target is not held after the timed motion: s = {self.final:.4f} at the end of the hold"
            )
        return None


@dataclass(frozen=True, eq=False)
class Trace:
    """The fine model at every substep of a replay.

    Attributes:
        t: Times [s], (m,), the start included.
        s, ds: The object's joint and its speed, (m,).
        touch: The fingertip touches the part, bool (m,).
        q_ref, q_meas, tau: Reference [rad], joints [rad] and torques [N·m] of the arm, (m, dof).
    """

    t: np.ndarray
    s: np.ndarray
    ds: np.ndarray
    touch: np.ndarray
    q_ref: np.ndarray
    q_meas: np.ndarray
    tau: np.ndarray


def trace_of(trajectory: Trajectory, request: PlanRequest, scene: Scene) -> Trace:
    """Play a trajectory as :func:`replay` does and note every substep."""
    world, dof = world_of(request, scene), scene.dof
    q_ref, control, _ = servo_targets(trajectory, request)
    begun, at_first = world.check_now(), copy.copy(world.data)
    played = play_side_by_side([world], control, 1, request.settings.threads)[0]
    qpos, qvel = np.vstack([at_first.qpos, played.qpos]), np.vstack([at_first.qvel, played.qvel])
    return Trace(
        t=np.append(at_first.time, played.t),
        s=qpos[:, scene.s_qpos],
        ds=qvel[:, scene.s_dof],
        touch=np.append(begun.touched, played.touch),
        q_ref=np.vstack([at_first.qpos[:dof], q_ref]),
        q_meas=qpos[:, :dof],
        tau=np.vstack([at_first.qfrc_actuator[:dof], played.tau]),
    )


def servo_targets(trajectory: Trajectory, request: PlanRequest) -> tuple[np.ndarray, np.ndarray, int]:
    """Reference (n, dof), servo targets (n, dof) at every substep to the end of the hold, substeps per control step."""
    settings = request.settings
    dt = settings.fine_timestep_s
    steps = int(np.ceil((trajectory.duration_s + settings.hold_s) / dt))
    times = np.minimum(np.arange(1, steps + 1) * dt, trajectory.duration_s)
    q, dq, _ = trajectory.sample(times)
    # A position servo damps against standing still; shifting its target by kd/kp dq makes it damp against dq.
    return q, q + settings.servo.kd / settings.servo.kp * dq, max(1, round(settings.control_dt_s / dt))


def replay(trajectory: Trajectory, request: PlanRequest, scene: Scene | None = None) -> Replay:
    """Play a trajectory at the fine model's rate (500 Hz) with the servos that follow it, then hold its end.

    The servos get position and velocity of the trajectory, as the drives do; every substep is checked.

    Args:
        trajectory: Starts at the request's ``q_initial``.
        request: The task: arm, object, start, target, settings.
        scene: The request's scene if it has been built already.
    """
    return replays(trajectory, request, [scene or scene_of(request)])[0]


def replays(trajectory: Trajectory, request: PlanRequest, scenes: list[Scene]) -> list[Replay]:
    """The same in several scenes that differ in numbers only, side by side on the request's threads."""
    if not scenes:
        return []
    worlds = [world_of(request, scene) for scene in scenes]
    before = [(world.check_now(), world.data.qpos.copy()) for world in worlds]
    _, control, chunk = servo_targets(trajectory, request)
    played = play_side_by_side(worlds, control, chunk, request.settings.threads)
    found = []
    for scene, (begun, qpos), one in zip(scenes, before, played, strict=True):
        report, t = begun.merged(one.report), np.append(0.0, one.t)
        found.append(_replay(request, scene, report, t, np.vstack([qpos, one.qpos])))
    return found


def _replay(request: PlanRequest, scene: Scene, report: Report, t: np.ndarray, qpos: np.ndarray) -> Replay:
    """What became of the task: times (m,) [s] and positions (m, nq) to the end of the hold."""
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    s = qpos[:, scene.s_qpos]
    hold = s[t > t[-1] - request.settings.hold_s]
    return Replay(
        t=t,
        s=s,
        q_meas=qpos[:, : scene.dof],
        final=float(s[-1]),
        error=request.s_target - float(s[-1]),
        hold_range=(float(hold.min()), float(hold.max())),
        held=bool(np.abs(hold - request.s_target).max() < 2.0 * tolerance),
        contact=report.contact,
        touched=report.touched,
        torque_share=report.torque_share,
        torque_joint=scene.arm.joint_names[report.torque_joint],
        press_N=report.press_N,
        contact_share=report.contact_share,
    )
