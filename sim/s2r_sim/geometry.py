"""Rotations, through MuJoCo's own functions."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np


def rotation_from_vector(rotation_vector: Sequence[float]) -> np.ndarray:
    """Rotation matrix, shape (3, 3), of a rotation vector [rad], shape (3,)."""
    angle = float(np.linalg.norm(rotation_vector))
    axis = np.asarray(rotation_vector, dtype=float) / angle if angle > 0 else np.array([1.0, 0.0, 0.0])
    quat_wxyz, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quat_wxyz, axis, angle)
    mujoco.mju_quat2Mat(matrix, quat_wxyz)
    return matrix.reshape(3, 3)
