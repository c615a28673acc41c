"""Straight lines of the fingertip at constant orientation, as dense joint paths."""

from __future__ import annotations

import numpy as np

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.inverse import InverseKinematics

SPACING_M = 0.005
LARGEST_JOINT_STEP_RAD = 0.12


def straight_line(
    arm: ArmModel,
    ik: InverseKinematics,
    q_start: np.ndarray,
    p_goal: np.ndarray,
    spacing_m: float = SPACING_M,
) -> np.ndarray | None:
    """Joint path that moves the fingertip straight to p_goal, orientation kept.

    Args:
        arm: Kinematics.
        ik: Solver.
        q_start: Start posture, shape (dof,).
        p_goal: Goal of the tool frame's origin in the base frame [m], shape (3,).
        spacing_m: Distance between solved points [m].

    Returns:
        Shape (n, dof) from q_start on, or None when a point is out of reach or the joints would jump.
    """
    X = arm.tool_pose(q_start)
    p_start = X[:3, 3].copy()
    count = max(1, int(np.ceil(np.linalg.norm(p_goal - p_start) / spacing_m)))
    path = [np.asarray(q_start, float)]
    for k in range(1, count + 1):
        X[:3, 3] = p_start + (p_goal - p_start) * k / count
        q = ik.solve(X, path[-1], iterations=20)
        if q is None or np.abs(q - path[-1]).max() > LARGEST_JOINT_STEP_RAD:
            return None
        path.append(q)
    return np.array(path)
