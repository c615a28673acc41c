"""A second opinion on a delivered trajectory: own stepping, own look at contacts, limits by differences.

Shares with the planner only the compiled fine model; everything else is written again on purpose.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRequest
from s2r_host.trajectory.trajectory import Trajectory
from s2r_protocol.arms.source import FINGER_PREFIX

_DT_S, _HOLD_S = 0.002, 0.5
_BAND = {True: 0.005, False: 0.02}  # held success: 5 mm, or 0.02 rad


@dataclass(frozen=True)
class Verdict:
    """What the verifier saw.

    Attributes:
        held: In the success band at the end of the motion and for half a second after it.
        contacts: Unexpected contacts, each pair once, as "geom against geom".
        violations: Limits that were exceeded, in words.
        final: The object's joint at the end of the hold.
        worst_hold: Largest distance from the target during the hold.
    """

    held: bool
    contacts: tuple[str, ...]
    violations: tuple[str, ...]
    final: float
    worst_hold: float

    @property
    def good(self) -> bool:
        """Held, nothing unexpected touched, no limit exceeded."""
        return self.held and not self.contacts and not self.violations


def verify(trajectory: Trajectory, request: PlanRequest, scene: Scene) -> Verdict:
    """Play a trajectory at 500 Hz in the fine model and judge it."""
    model, arm = scene.fine, request.arm
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in arm.joint_names]
    where, dofs = [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]
    s_at = int(model.joint(scene.joint_name).qposadr[0])
    motors = [model.actuator(name).id for name in arm.joint_names]
    data.qpos[where], data.qpos[s_at] = request.q_initial, request.s_initial
    mujoco.mj_forward(model, data)
    part = _below(model, scene.part_body)
    robot = _below(model, model.body(arm.source.base).id)
    gain = request.settings.servo.kd / request.settings.servo.kp
    times = np.arange(1, int(np.ceil((trajectory.duration_s + _HOLD_S) / _DT_S)) + 1) * _DT_S
    contacts: dict[str, None] = {}
    torque, hold = np.zeros(arm.dof), []
    for t in times:
        q, dq, _ = trajectory.sample(min(t, trajectory.duration_s))
        data.ctrl[motors] = q + gain * dq
        mujoco.mj_step(model, data)
        torque = np.maximum(torque, np.abs(data.qfrc_actuator[dofs]))
        for first, second in data.contact.geom:
            pair = _unexpected(model, int(first), int(second), robot, part)
            if pair is not None:
                contacts[pair] = None
        if t >= trajectory.duration_s:
            hold.append(abs(request.s_target - float(data.qpos[s_at])))
    prismatic = model.jnt_type[model.joint(scene.joint_name).id] == mujoco.mjtJoint.mjJNT_SLIDE
    held = max(hold) < _BAND[bool(prismatic)]
    return Verdict(
        held,
        tuple(contacts),
        tuple(_violations(trajectory, request, torque)),
        float(data.qpos[s_at]),
        max(hold),
    )


def _below(model: mujoco.MjModel, root: int) -> set[int]:
    found = {root}
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return found


def _unexpected(
    model: mujoco.MjModel, first: int, second: int, robot: set[int], part: set[int]
) -> str | None:
    bodies = [int(model.geom_bodyid[g]) for g in (first, second)]
    if not robot & set(bodies):
        return None  # things of the scene among themselves
    names = [model.geom(g).name or f"geom {g}" for g in (first, second)]
    for own, other in ((0, 1), (1, 0)):
        if names[own].startswith(FINGER_PREFIX) and bodies[own] in robot and bodies[other] in part:
            return None
    return " against ".join(names)


def _violations(trajectory: Trajectory, request: PlanRequest, torque: np.ndarray) -> list[str]:
    """Limits exceeded by finite differences of densely sampled positions, and by the fine model's torques."""
    limits, dt = request.arm.limits, 0.001
    t = np.arange(0.0, trajectory.duration_s, dt)
    q = trajectory.sample(t)[0]
    found = []
    rates = [np.abs(np.diff(q, n, axis=0)).max(axis=0) / dt**n for n in (1, 2, 3)]
    bounds = (limits.dq_max, limits.ddq_max, limits.dddq_max)
    for i, name in enumerate(request.arm.joint_names):
        if q[:, i].min() < limits.q_min[i] or q[:, i].max() > limits.q_max[i]:
            found.append(f"{name} leaves its range")
        for what, value, bound in zip(("velocity", "acceleration", "jerk"), rates, bounds, strict=True):
            if value[i] > bound[i]:
                found.append(f"{name}: {what} {value[i]:.3f} over {bound[i]:.3f}")
        if torque[i] > limits.tau_max[i]:
            found.append(f"{name}: torque {torque[i]:.1f} over {limits.tau_max[i]:.1f}")
    return found
