"""The twin: the nominal arm under a nominal drive law, fed with the references the real arm gets.

Drive law: computed torque with a critically damped error dynamics of bandwidth ``OMEGA``. It knows nothing of
friction, play or payload; where the real arm leaves it, there is something to look at.
"""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_protocol.arms import ArmDescription

OMEGA = 40.0  # [rad/s]
STEP_S = 0.004
MAX_BEHIND_S = 0.2


class Twin:
    """Follows references in real time. Not thread-safe."""

    def __init__(self, arm: ArmDescription) -> None:
        self._model = mujoco.MjModel.from_xml_string(arm.mjcf)
        self._model.opt.timestep = STEP_S
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._data = mujoco.MjData(self._model)
        self._time_s: float | None = None

    def follow(self, now_s: float, q_ref: np.ndarray, dq_ref: np.ndarray) -> np.ndarray:
        """Simulate up to ``now_s`` [s] towards the newest reference; the twin's joints [rad], shape (dof,).

        After a pause longer than 0.2 s it starts anew at the reference.
        """
        data = self._data
        if self._time_s is None or now_s - self._time_s > MAX_BEHIND_S:
            data.qpos[:], data.qvel[:] = q_ref, dq_ref
            self._time_s = now_s
            return q_ref.copy()
        while self._time_s + STEP_S <= now_s:
            self._time_s += STEP_S
            mujoco.mj_fwdPosition(self._model, data)
            mujoco.mj_fwdVelocity(self._model, data)
            ddq = OMEGA**2 * (q_ref - data.qpos) + 2.0 * OMEGA * (dq_ref - data.qvel)
            torque = np.zeros(self._model.nv)
            mujoco.mj_mulM(self._model, data, torque, ddq)
            data.qfrc_applied[:] = torque + data.qfrc_bias
            mujoco.mj_step(self._model, data)
        return data.qpos.copy()
