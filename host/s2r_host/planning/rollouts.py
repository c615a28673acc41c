"""Rollouts of many action sequences in the coarse model, on the threads of ``mujoco.batch``.

With several believable objects every sequence is played once with each of them, side by side in one batch.
"""

from __future__ import annotations

import functools

import mujoco
import mujoco.batch
import numpy as np

from s2r_host.planning.belief import Belief, let_part_pass, spread_over
from s2r_host.planning.hook import Hook
from s2r_host.planning.rewards import Task, make_scorer
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings, Stage

_CONTROL = int(mujoco.mjtState.mjSTATE_CTRL)
_MOVED = 1e-4  # [m or rad] an object that has gone less far has not been pushed
_LEAST_LEVER_M = 0.02
_RECORD = ("qpos", "qvel", "sensordata")


class Rollouts:
    """Evaluates joint-target sequences from one start state. One per plan and Python thread."""

    def __init__(
        self,
        scene: Scene,
        stage: Stage,
        settings: PlanSettings,
        hook: Hook,
        capacity: int,
        beliefs: tuple[Belief, ...] = (),
        others: np.ndarray | None = None,
    ) -> None:
        """Play with some believable objects, or with the one as given.

        Args: scene; stage; settings; the place for the fingertip; ``capacity``, most sequences per call; the objects;
        ``others``, see PlanRequest: what carries the part turns the push on it.
        """
        self.members = max(1, len(beliefs))
        self._scene, self._hook = scene, hook
        at_zero = mujoco.MjData(scene.fine)
        if others is not None:
            at_zero.qpos[scene.dof :] = others
        at_zero.qpos[scene.s_qpos] = 0.0
        mujoco.mj_kinematics(scene.fine, at_zero)
        self._R_world_part = at_zero.xmat[scene.part_body].reshape(3, 3)
        self._axis_part = scene.fine.jnt_axis[scene.joint_id]
        self._substeps = round(settings.control_dt_s / stage.timestep_s)
        model = scene.rollout_model(stage)
        if not scene.on_table and any(belief.moves_joint for belief in beliefs):
            let_part_pass(model, scene)
        self._scorer = make_scorer(scene, settings, hook, self._substeps, self._R_world_part)
        self._batch = mujoco.batch.Batch(model, nsim=capacity * self.members, nthread=settings.threads)
        self._shifts = np.array([b.shift_m for b in beliefs]).reshape(-1, 3)
        self._along = np.array([b.along for b in beliefs])
        if beliefs:
            spread_over(self._batch, scene, beliefs)
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._warmstart = self._batch.bind("qacc_warmstart")
        self._unused_controls = model.nu - scene.dof
        self._records: dict[tuple[int, int], dict[mujoco.batch.RecordItem, np.ndarray]] = {}
        self.env_steps = 0

    def values(self, qpos: np.ndarray, qvel: np.ndarray, targets: np.ndarray, task: Task) -> np.ndarray:
        """What sequences of joint targets from one state are worth, (rollout,): their reward's mean over the steps.

        Args:
            qpos, qvel: Start state of arm and object, (nq,), (nv,).
            targets: Joint targets including the one in force at the start, (rollout, steps + 1, dof) [rad].
            task: What the reward compares with.

        With several believable objects every sequence is worth the mean over them.
        """
        if self.members > 1:
            targets = np.repeat(targets, self.members, axis=0)
        rollouts, steps = targets.shape[0], targets.shape[1] - 1
        self._qpos[:rollouts] = qpos
        if self.members > 1:
            s = self._where_pushed(float(qpos[self._scene.s_qpos]), task.s_initial)
            self._qpos[:rollouts, self._scene.s_qpos] = np.resize(s, rollouts)
        self._qvel[:rollouts] = qvel
        self._warmstart[:rollouts] = 0.0  # the same start for every rollout, whatever was computed before
        control = ramp(targets, self._substeps)
        if self._unused_controls:
            rest = np.zeros((*control.shape[:2], self._unused_controls))
            control = np.concatenate([control, rest], axis=2)
        # Written into the same arrays again and again: fresh ones of this size cost page faults on every thread.
        shape = rollouts, control.shape[1]
        record = self._records[shape] = self._batch.rollout(
            shape[1], control, _CONTROL, _RECORD, ids=np.arange(rollouts), out=self._records.get(shape)
        )
        self.env_steps += rollouts * steps
        found = self._scorer.values(record["qpos"], record["qvel"], record["sensordata"], targets, qvel, task)
        return found.reshape(-1, self.members).mean(axis=1) if self.members > 1 else found

    def _where_pushed(self, s: float, s_initial: float) -> np.ndarray:
        """The joint of every believable object where the believed one has been pushed to s, (members,).

        The fingertip is at the part. One that stands nearer was met earlier and has gone further by now, one that
        stands farther less far, or has not been met yet: else the fingertip would begin inside of it, or off it.
        """
        gone = s - s_initial
        if abs(gone) < _MOVED:
            return np.full(self.members, s)
        push, lever = self._hook.push_as_part_moves @ (1.0, np.cos(s), np.sin(s)), 1.0
        if not self._scene.prismatic:
            arm = self._hook.p_part - self._scene.fine.jnt_pos[self._scene.joint_id]
            lever = max(_LEAST_LEVER_M, float(np.linalg.norm(np.cross(self._axis_part, arm))))
        ahead = np.sign(gone) * (self._shifts @ (self._R_world_part @ push)) / lever + self._along
        return s_initial + np.sign(gone) * np.maximum(np.sign(gone) * (gone - ahead), 0.0)


def ramp(targets: np.ndarray, substeps: int) -> np.ndarray:
    """Joint targets at every substep: straight lines between control steps, (rollout, steps * substeps, dof)."""
    return _lines(targets.shape[1] - 1, substeps) @ targets


@functools.cache
def _lines(steps: int, substeps: int) -> np.ndarray:
    """Weights of the control steps at every substep of straight lines between them, (steps * substeps, steps + 1)."""
    step = np.arange(1, steps * substeps + 1) / substeps
    return np.maximum(1.0 - np.abs(step[:, None] - np.arange(steps + 1)), 0.0)
