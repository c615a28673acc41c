"""Rollouts of many action sequences in the coarse model, on the threads of ``mujoco.batch``.

With several believable objects every sequence is played once with each of them, side by side in one batch.
"""

from __future__ import annotations

import mujoco
import mujoco.batch
import numpy as np

from s2r_host.planning.belief import Belief, spread_over
from s2r_host.planning.hooking import Hook
from s2r_host.planning.rewards import StepFacts
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings, Stage

_CONTROL = int(mujoco.mjtState.mjSTATE_CTRL)
# The coarse model's sensors: tool pose (7), the robot's contacts (1), per finger contacts (1) and force (3).
_ROBOT_CONTACTS, _FIRST_FINGER, _PER_FINGER = 7, 8, 4


class Rollouts:
    """Evaluates joint-target sequences from one start state. One per plan and Python thread."""

    def __init__(
        self,
        scene: Scene,
        stage: Stage,
        settings: PlanSettings,
        capacity: int,
        beliefs: tuple[Belief, ...] = (),
    ) -> None:
        """Args: scene; stage; settings; ``capacity``, most sequences per call; believable objects, none: as given."""
        self.members = max(1, len(beliefs))
        self._scene = scene
        self._servo = settings.servo
        at_zero = mujoco.MjData(scene.fine)
        at_zero.qpos[scene.s_qpos] = 0.0
        mujoco.mj_kinematics(scene.fine, at_zero)
        self._R_world_part = at_zero.xmat[scene.part_body].reshape(3, 3)
        self._axis_part = scene.fine.jnt_axis[scene.joint_id]
        self._cross_axis = np.cross(self._axis_part, np.eye(3))  # row vector times this: axis x vector
        self._control_dt_s = settings.control_dt_s
        self._substeps = round(settings.control_dt_s / stage.timestep_s)
        model = scene.rollout_model(stage)
        self._batch = mujoco.batch.Batch(model, nsim=capacity * self.members, nthread=settings.threads)
        if beliefs:
            spread_over(self._batch, scene, beliefs)
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._warmstart = self._batch.bind("qacc_warmstart")
        self._unused_controls = model.nu - scene.dof
        self.env_steps = 0

    def run(self, qpos: np.ndarray, qvel: np.ndarray, targets: np.ndarray, hook: Hook) -> StepFacts:
        """Play sequences of joint targets from one state.

        Args:
            qpos, qvel: Start state of arm and object, (nq,), (nv,).
            targets: Joint targets including the one in force at the start, (rollout, steps + 1, dof) [rad].
            hook: The place that the fingertip is measured against.

        Returns:
            What the reward needs, with ``steps`` entries along time; with several beliefs, ``members`` rollouts in
            succession for every sequence.
        """
        if self.members > 1:
            targets = np.repeat(targets, self.members, axis=0)
        rollouts, steps = targets.shape[0], targets.shape[1] - 1
        ids = np.arange(rollouts)
        self._qpos[ids] = qpos
        self._qvel[ids] = qvel
        self._warmstart[ids] = 0.0  # the same start for every rollout, whatever was computed before
        control = ramp(targets, self._substeps)
        if self._unused_controls:
            rest = np.zeros((*control.shape[:2], self._unused_controls))
            control = np.concatenate([control, rest], axis=2)
        record = self._batch.rollout(
            control.shape[1], control, _CONTROL, ("qpos", "qvel", "sensordata"), ids=ids
        )
        self.env_steps += rollouts * steps
        return self._facts(record, qvel, targets, hook)

    def _facts(self, record: dict, qvel: np.ndarray, targets: np.ndarray, hook: Hook) -> StepFacts:
        scene, n = self._scene, self._substeps
        dof = scene.dof
        s = record["qpos"][:, n - 1 :: n, scene.s_qpos]
        q = record["qpos"][:, n - 1 :: n, :dof]
        dq = record["qvel"][:, n - 1 :: n, :dof]
        before = np.broadcast_to(qvel[:dof], (len(dq), 1, dof))
        ddq = np.diff(dq, axis=1, prepend=before) / self._control_dt_s
        # Sensors and contacts describe the state before a substep: one substep behind qpos.
        sensors = record["sensordata"]
        touches = np.zeros(sensors.shape[:2])
        for finger in range(_FIRST_FINGER, sensors.shape[2], _PER_FINGER):
            touches += sensors[..., finger]
        press_N = self._press(sensors, touches, record["qpos"][:, :, scene.s_qpos], hook)
        collides = sensors[..., _ROBOT_CONTACTS] > touches
        after = np.minimum(np.arange(n, sensors.shape[1] + 1, n), sensors.shape[1] - 1)
        pose = sensors[:, after, :_ROBOT_CONTACTS]
        return StepFacts(
            distance_m=hook.distance(pose[..., :3]),
            turn_rad=hook.turn(pose[..., 3:], record["qpos"][:, after, scene.s_qpos]),
            s=s,
            ds=record["qvel"][:, n - 1 :: n, scene.s_dof],
            touches=_any_within(touches > 0, n),
            collides=_any_within(collides, n),
            press_N=press_N.reshape(len(s), -1, n).max(axis=2),
            dq=dq,
            ddq=ddq,
            load=(self._servo.kp * (targets[:, 1:] - q) - self._servo.kd * dq) / scene.arm.limits.tau_max,
        )

    def _press(self, sensors: np.ndarray, touches: np.ndarray, s: np.ndarray, hook: Hook) -> np.ndarray:
        """Size of the fingertip's force across the part's motion [N], (rollout, substep); zero where none touches."""
        press_N = np.zeros(touches.size)
        at = np.flatnonzero(touches)
        if not len(at):
            return press_N.reshape(touches.shape)
        rows = sensors.reshape(touches.size, -1)[at]
        force_N = np.zeros((len(rows), 3))
        for finger in range(_FIRST_FINGER, rows.shape[1], _PER_FINGER):
            force_N += rows[:, finger + 1 : finger + _PER_FINGER]
        force_N = force_N @ self._R_world_part
        if not self._scene.prismatic:
            # The part has turned by s about its axis: turn the force back into the part's frame.
            angle = s.ravel()[at]
            along = (force_N @ self._axis_part)[:, None] * self._axis_part
            crossed = force_N @ self._cross_axis
            force_N = along + np.cos(angle)[:, None] * (force_N - along) - np.sin(angle)[:, None] * crossed
        motion = hook.push_part / np.linalg.norm(hook.push_part)
        across = np.einsum("ni,ni->n", force_N, force_N) - (force_N @ motion) ** 2
        press_N[at] = np.sqrt(np.maximum(across, 0.0))
        return press_N.reshape(touches.shape)


def ramp(targets: np.ndarray, substeps: int) -> np.ndarray:
    """Joint targets at every substep: straight lines between control steps, (rollout, steps * substeps, dof)."""
    share = (np.arange(substeps) + 1.0) / substeps
    start, end = targets[:, :-1, None], targets[:, 1:, None]
    values = start + share[None, None, :, None] * (end - start)
    return np.ascontiguousarray(values.reshape(len(targets), -1, targets.shape[2]))


def _any_within(flags: np.ndarray, substeps: int) -> np.ndarray:
    """Per control step, True if the flag, which lags one substep, was up at any of its substeps."""
    lagged = np.concatenate([flags[:, 1:], flags[:, -1:]], axis=1)
    return np.logical_or.reduce(lagged.reshape(len(flags), -1, substeps), axis=2)
