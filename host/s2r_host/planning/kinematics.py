"""Joint solutions for tool poses, and poses for joint positions, on the arm alone."""

from __future__ import annotations

import mujoco
import mujoco.batch
import numpy as np

from s2r_host.planning.scene import Scene

_CHUNK = 256
_NEAR_M, _NEAR_RAD = 1e-3, 1e-2  # a solution is this near to the wanted pose
_DAMPING = 1e-4 * np.eye(6)


class ToolKinematics:
    """Forward and inverse kinematics of the tool site, one or many at a time. Not for several threads."""

    def __init__(self, scene: Scene, joint_margin_rad: float, threads: int = 1) -> None:
        """Args: scene; ``joint_margin_rad``, distance that solutions keep from the position limits; threads."""
        model = mujoco.MjSpec.from_string(scene.arm.mjcf).compile()
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._dof = scene.dof
        self._site = model.site(scene.arm.tool_frame).id
        self._joints = np.array([model.joint(name).id for name in scene.arm.joint_names])
        self._batch = mujoco.batch.Batch(model, nsim=_CHUNK, nthread=threads)
        self._ids = np.arange(_CHUNK, dtype=np.int32)
        self._fields = {
            name: self._batch.bind(name) for name in ("qpos", "site_xpos", "site_xmat", "xaxis", "xanchor")
        }
        self.q_min = scene.arm.limits.q_min + joint_margin_rad
        self.q_max = scene.arm.limits.q_max - joint_margin_rad

    def poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool positions (n, 3) [m] and rotations (n, 3, 3) in the base frame at joint positions (n, dof)."""
        p, R, _ = self._all(np.atleast_2d(q))
        return p, R

    def pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool position (3,) [m] and rotation (3, 3) in the base frame at joint positions (dof,)."""
        p, R = self.poses(q)
        return p[0], R[0]

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Jacobian of the tool at q, (6, dof): linear velocity over angular velocity, base frame."""
        return self._all(np.atleast_2d(q))[2][0]

    def tips(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool positions (n, 3) [m] and Jacobians of their velocity (n, 3, dof), base frame, at q (n, dof)."""
        p, _, jacobian = self._all(q)
        return p, jacobian[:, :3]

    def solve(self, p_world: np.ndarray, R_world_tool: np.ndarray, q_start: np.ndarray) -> np.ndarray | None:
        """Joint positions near ``q_start`` that reach a tool pose, or None."""
        q, found = self.solve_many(p_world[None], R_world_tool[None], np.asarray(q_start)[None])
        return q[0] if found[0] else None

    def solve_many(
        self, p_world: np.ndarray, R_world_tool: np.ndarray, q_start: np.ndarray, iterations: int = 10
    ) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions near starts (n, dof) that reach tool poses (n, 3), (n, 3, 3), and which do, bool (n,).

        Damped least squares with the position limits as a clip; a solution is within 1 mm and 10 mrad. From another
        posture it takes 3 to 7 iterations, from a neighbouring one 2 or 3; what takes more is hardly ever found.
        """
        q = np.clip(q_start, self.q_min, self.q_max)
        found = np.zeros(len(q), dtype=bool)
        left = np.arange(len(q))
        for _ in range(iterations):
            p, R, jacobian = self._all(q[left])
            error = np.concatenate([p_world[left] - p, rotation_errors(R, R_world_tool[left])], axis=1)
            far, turn = _lengths(error[:, :3]), _lengths(error[:, 3:])
            there = (far < _NEAR_M) & (turn < _NEAR_RAD)
            if there.any():
                found[left[there]] = True
                on = ~there
                left, error, jacobian, far, turn = left[on], error[on], jacobian[on], far[on], turn[on]
                if not len(left):
                    break
            error[:, :3] *= np.minimum(1.0, 0.2 / np.maximum(far, 1e-9))[:, None]
            error[:, 3:] *= np.minimum(1.0, 0.6 / np.maximum(turn, 1e-9))[:, None]
            transposed = jacobian.transpose(0, 2, 1)
            damped = jacobian @ transposed + _DAMPING
            step = (transposed @ np.linalg.solve(damped, error[..., None]))[..., 0]
            q[left] = np.minimum(np.maximum(q[left] + step, self.q_min), self.q_max)
        return q, found

    def _all(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions (n, 3), rotations (n, 3, 3), Jacobians (n, 6, dof)."""
        n = len(q)
        p, R, jacobian = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 6, self._dof))
        for start in range(0, n, _CHUNK):
            part = slice(start, start + _CHUNK)
            ids = self._ids[: len(q[part])]
            self._fields["qpos"][: len(ids)] = q[part]
            self._batch.forward(ids=ids, stage=int(mujoco.mjtStage.mjSTAGE_POS))
            p[part] = self._fields["site_xpos"][: len(ids), self._site]
            R[part] = self._fields["site_xmat"][: len(ids), self._site].reshape(-1, 3, 3)
            axis = self._fields["xaxis"][: len(ids), self._joints].transpose(0, 2, 1)
            anchor = self._fields["xanchor"][: len(ids), self._joints].transpose(0, 2, 1)
            (x, y, z), (a, b, c) = axis.swapaxes(0, 1), (p[part, :, None] - anchor).swapaxes(0, 1)
            # axis x lever; numpy's own cross product takes longer than all the rest here
            jacobian[part, 0], jacobian[part, 1], jacobian[part, 2] = (
                y * c - z * b,
                z * a - x * c,
                x * b - y * a,
            )
            jacobian[part, 3:] = axis
        return p, R, jacobian


def rotation_errors(R_now: np.ndarray, R_goal: np.ndarray) -> np.ndarray:
    """Rotation vectors [rad] in the world frame that turn ``R_now`` into ``R_goal``, (n, 3) for (n, 3, 3)."""
    R = R_goal @ R_now.transpose(0, 2, 1)
    vector = R[:, (2, 0, 1), (1, 2, 0)] - R[:, (1, 2, 0), (2, 0, 1)]
    sine = _lengths(vector) / 2.0
    angle = np.arctan2(sine, (R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2] - 1.0) / 2.0)
    scale = np.where(sine > 1e-6, angle / np.maximum(2.0 * sine, 1e-12), 0.5)
    # Near half a turn the antisymmetric part vanishes: any axis turns nearer, x does as well as another.
    result = vector * scale[:, None]
    result[(sine <= 1e-6) & (angle > 1.0)] = [np.pi, 0.0, 0.0]
    return result


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths of vectors (n, k), (n,); for so few numbers each, NumPy's own norm takes three times as long."""
    return np.sqrt(np.vecdot(vectors, vectors))
