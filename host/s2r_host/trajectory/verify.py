"""Replay of a timed trajectory in the fine model: where the object ends and what happens on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.scene import Scene, build_scene
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
        held: The joint moved less than half the success band during the second half of the hold.
        contact: First contact that was not fingertip against part, or None.
        touched: The fingertip touched the part.
        torque_share: Largest torque over its limit.
        torque_joint: Name of that joint.
        press_N: Largest force of the fingertip on the part across the part's motion.
    """

    t: np.ndarray
    s: np.ndarray
    q_meas: np.ndarray
    final: float
    error: float
    held: bool
    contact: str | None
    touched: bool
    torque_share: float
    torque_joint: str
    press_N: float

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
        if not self.held:
            return f"the target is not held after the timed motion: s = {self.final:.4f} and still moving"
        if abs(self.error) >= tolerance:
            return f"the timed motion ends at s = {self.final:.4f}, {self.error:+.4f} from the target"
        return None


def replay(trajectory: Trajectory, request: PlanRequest, scene: Scene | None = None) -> Replay:
    """Play a trajectory at the fine model's rate (500 Hz) with the servos that follow it, then hold its end.

    The servos get position and velocity of the trajectory, as the drives do; every substep is checked.

    Args:
        trajectory: Starts at the request's ``q_initial``.
        request: The task: arm, object, start, target, settings.
        scene: The request's scene if it has been built already.
    """
    settings = request.settings
    scene = scene or build_scene(request.arm, request.object_mjcf, request.joint, settings)
    tolerance = settings.tolerance_m if scene.prismatic else settings.tolerance_rad
    world = FineWorld(scene, np.asarray(request.q_initial, dtype=float), request.s_initial)
    dt = settings.fine_timestep_s
    steps = int(np.ceil((trajectory.duration_s + settings.hold_s) / dt))
    times = np.minimum(np.arange(1, steps + 1) * dt, trajectory.duration_s)
    q, dq, _ = trajectory.sample(times)
    # A position servo damps against standing still; shifting its target by kd/kp dq makes it damp against dq.
    control = q + settings.servo.kd / settings.servo.kp * dq
    chunk = max(1, round(settings.control_dt_s / dt))
    report, s, q_meas, t = world.check_now(), [world.s], [world.q], [0.0]
    for start in range(0, steps, chunk):
        report = report.merged(world.play(control[start : start + chunk]))
        s.append(world.s)
        q_meas.append(world.q)
        t.append(float(world.data.time))
    t_all, s_all = np.array(t), np.array(s)
    late = s_all[t_all > t_all[-1] - settings.hold_s / 2.0]
    return Replay(
        t=t_all,
        s=s_all,
        q_meas=np.array(q_meas),
        final=world.s,
        error=request.s_target - world.s,
        held=bool(np.abs(late - world.s).max() < tolerance / 2.0),
        contact=report.contact,
        touched=report.touched,
        torque_share=report.torque_share,
        torque_joint=scene.arm.joint_names[report.torque_joint],
        press_N=report.press_N,
    )
