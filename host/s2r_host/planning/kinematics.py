"""Joint solutions for tool poses, and poses for joint positions, on the fine model alone."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.planning.scene import Scene


class ToolKinematics:
    """Forward and inverse kinematics of the tool site. Keeps its own MjData; not for several threads."""

    def __init__(self, scene: Scene, joint_margin_rad: float) -> None:
        """Args: scene; ``joint_margin_rad``, distance that solutions keep from the position limits."""
        self._model = scene.fine
        self._data = mujoco.MjData(scene.fine)
        self._site = scene.tool_site
        self._dof = scene.dof
        self.q_min = scene.arm.limits.q_min + joint_margin_rad
        self.q_max = scene.arm.limits.q_max - joint_margin_rad

    def pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool position (3,) [m] and rotation (3, 3) in the world frame at joint positions (dof,)."""
        self._data.qpos[: self._dof] = q
        mujoco.mj_kinematics(self._model, self._data)
        return self._data.site_xpos[self._site].copy(), self._data.site_xmat[self._site].reshape(3, 3).copy()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Jacobian of the tool at q, (6, dof): linear velocity over angular velocity, world frame."""
        self.pose(q)
        mujoco.mj_comPos(self._model, self._data)
        jacobian = np.empty((6, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._site)
        return jacobian[:, : self._dof]

    def solve(
        self, p_world: np.ndarray, R_world_tool: np.ndarray, q_start: np.ndarray, iterations: int = 40
    ) -> np.ndarray | None:
        """Joint positions near ``q_start`` that reach a tool pose, or None.

        Damped least squares with the position limits as a clip; a solution is within 1 mm and 10 mrad.
        """
        q = np.clip(q_start, self.q_min, self.q_max)
        for _ in range(iterations):
            jacobian = self.jacobian(q)
            p_tool = self._data.site_xpos[self._site]
            error = np.concatenate([p_world - p_tool, rotation_error(self._rotation(), R_world_tool)])
            if np.linalg.norm(error[:3]) < 1e-3 and np.linalg.norm(error[3:]) < 1e-2:
                return q
            error[:3] *= min(1.0, 0.2 / max(np.linalg.norm(error[:3]), 1e-9))
            error[3:] *= min(1.0, 0.6 / max(np.linalg.norm(error[3:]), 1e-9))
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-4 * np.eye(6), error)
            q = np.clip(q + step, self.q_min, self.q_max)
        return None

    def _rotation(self) -> np.ndarray:
        return self._data.site_xmat[self._site].reshape(3, 3)


def rotation_error(R_now: np.ndarray, R_goal: np.ndarray) -> np.ndarray:
    """Rotation vector [rad] in the world frame that turns ``R_now`` into ``R_goal``, (3,)."""
    quat_wxyz, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat_wxyz, (R_goal @ R_now.T).ravel())
    mujoco.mju_quat2Vel(vector, quat_wxyz, 1.0)
    return vector
