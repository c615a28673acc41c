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
from s2r_host.planning.rewards import StepFacts
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings, Stage

_CONTROL = int(mujoco.mjtState.mjSTATE_CTRL)
_MOVED = 1e-4  # [m or rad] an object that has gone less far has not been pushed
_LEAST_LEVER_M = 0.02
_RECORD = ("qpos", "qvel", "sensordata")
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
        self._control_dt_s = settings.control_dt_s
        self._substeps = round(settings.control_dt_s / stage.timestep_s)
        model = scene.rollout_model(stage)
        if not scene.on_table and any(belief.moves_joint for belief in beliefs):
            let_part_pass(model, scene)
        # A row of sensors times this: the force of all finger shapes together, in the part's frame at s = 0.
        self._force_of = np.zeros((model.nsensordata, 3))
        for finger in range(_FIRST_FINGER, model.nsensordata, _PER_FINGER):
            self._force_of[finger + 1 : finger + _PER_FINGER] = self._R_world_part
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

    def run(
        self, qpos: np.ndarray, qvel: np.ndarray, targets: np.ndarray, hook: Hook, s_initial: float
    ) -> StepFacts:
        """Play sequences of joint targets from one state.

        Args:
            qpos, qvel: Start state of arm and object, (nq,), (nv,).
            targets: Joint targets including the one in force at the start, (rollout, steps + 1, dof) [rad].
            hook: The place that the fingertip is measured against.
            s_initial: The object's joint before anything touched it.

        Returns:
            What the reward needs, with ``steps`` entries along time; with several beliefs, ``members`` rollouts in
            succession for every sequence. Good until the next call.
        """
        if self.members > 1:
            targets = np.repeat(targets, self.members, axis=0)
        rollouts, steps = targets.shape[0], targets.shape[1] - 1
        self._qpos[:rollouts] = qpos
        if self.members > 1:
            s = self._where_pushed(float(qpos[self._scene.s_qpos]), hook, s_initial)
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
        return self._facts(record, qvel, targets, hook)

    def _where_pushed(self, s: float, hook: Hook, s_initial: float) -> np.ndarray:
        """The joint of every believable object where the believed one has been pushed to s, (members,).

        The fingertip is at the part. One that stands nearer was met earlier and has gone further by now, one that
        stands farther less far, or has not been met yet: else the fingertip would begin inside of it, or off it.
        """
        gone = s - s_initial
        if abs(gone) < _MOVED:
            return np.full(self.members, s)
        push, lever = hook.push_as_part_moves @ (1.0, np.cos(s), np.sin(s)), 1.0
        if not self._scene.prismatic:
            arm = hook.p_part - self._scene.fine.jnt_pos[self._scene.joint_id]
            lever = max(_LEAST_LEVER_M, float(np.linalg.norm(np.cross(self._axis_part, arm))))
        ahead = np.sign(gone) * (self._shifts @ (self._R_world_part @ push)) / lever + self._along
        return s_initial + np.sign(gone) * np.maximum(np.sign(gone) * (gone - ahead), 0.0)

    def _facts(self, record: dict, qvel: np.ndarray, targets: np.ndarray, hook: Hook) -> StepFacts:
        scene, n, dof = self._scene, self._substeps, self._scene.dof
        # Sensors and contacts describe the state before a substep: one substep behind qpos.
        qpos, ends, sensors = record["qpos"], record["qvel"][:, n - 1 :: n], record["sensordata"]
        s, q, dq = qpos[:, n - 1 :: n, scene.s_qpos], qpos[:, n - 1 :: n, :dof], ends[..., :dof].copy()
        ddq = dq.copy()
        ddq[:, 1:] -= dq[:, :-1]
        ddq[:, 0] -= qvel[:dof]
        ddq /= self._control_dt_s
        touches = sensors[..., _FIRST_FINGER]
        for finger in range(_FIRST_FINGER + _PER_FINGER, sensors.shape[2], _PER_FINGER):
            touches = touches + sensors[..., finger]
        press_N = self._press(sensors, touches, qpos[..., scene.s_qpos], hook)
        # Where the next control step begins, or the last substep: the sensors lag.
        tool = sensors[:, _after(n, sensors.shape[1]), :_ROBOT_CONTACTS]
        load = targets[:, 1:] - q
        load *= self._servo.kp
        load -= self._servo.kd * dq
        load /= scene.arm.limits.tau_max
        return StepFacts(
            distance_m=hook.distance(tool[..., :3]),
            turn_rad=hook.turn(tool[..., 3:], qpos[:, _after(n, sensors.shape[1]), scene.s_qpos]),
            s=s,
            ds=ends[..., scene.s_dof],
            touches=_any_within(touches > 0, n),
            collides=_any_within(sensors[..., _ROBOT_CONTACTS] > touches, n),
            press_N=functools.reduce(np.maximum, (press_N[:, k::n] for k in range(n))),
            dq=dq,
            ddq=ddq,
            load=load,
        )

    def _press(self, sensors: np.ndarray, touches: np.ndarray, s: np.ndarray, hook: Hook) -> np.ndarray:
        """Size of the fingertip's force across the part's motion [N], (rollout, substep); zero where none touches."""
        press_N = np.zeros(touches.shape)
        at = np.flatnonzero(touches)
        force_N = sensors.reshape(touches.size, -1).take(at, axis=0) @ self._force_of
        push_N, cosine_N, sine_N = (force_N @ hook.push_as_part_moves).T
        if not self._scene.prismatic:
            angle = s.reshape(-1)[at]
            push_N = push_N + np.cos(angle) * cosine_N + np.sin(angle) * sine_N
        across = np.vecdot(force_N, force_N) - push_N**2
        press_N.reshape(-1)[at] = np.sqrt(np.maximum(across, 0.0))
        return press_N


def ramp(targets: np.ndarray, substeps: int) -> np.ndarray:
    """Joint targets at every substep: straight lines between control steps, (rollout, steps * substeps, dof)."""
    return _lines(targets.shape[1] - 1, substeps) @ targets


@functools.cache
def _lines(steps: int, substeps: int) -> np.ndarray:
    """Weights of the control steps at every substep of straight lines between them, (steps * substeps, steps + 1)."""
    step = np.arange(1, steps * substeps + 1) / substeps
    return np.maximum(1.0 - np.abs(step[:, None] - np.arange(steps + 1)), 0.0)


@functools.cache
def _after(substeps: int, count: int) -> np.ndarray:
    """Per control step the substep whose sensors describe its end, of ``count`` substeps."""
    return np.minimum(np.arange(substeps, count + 1, substeps), count - 1)


def _any_within(flags: np.ndarray, substeps: int) -> np.ndarray:
    """Per control step, True if the flag, which lags one substep, was up at any of its substeps."""
    found = flags[:, _after(substeps, flags.shape[1])]
    for k in range(1, substeps):
        found |= flags[:, k::substeps]
    return found
