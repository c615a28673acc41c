"""How the arm has to move on for the fingertip to go along with the part."""

from __future__ import annotations

import numpy as np

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.kinematics import ToolKinematics
from s2r_host.planning.scene import Scene


def shift_with_part(q: np.ndarray, s: float, scene: Scene, others: np.ndarray | None = None) -> np.ndarray:
    """Change of a posture per unit of the object's joint: the fingertip goes along with the part, (dof,).

    Args:
        q: The arm's joints [rad], (dof,).
        s: The object's joint [m or rad].
        scene: Both.
        others: Positions of everything besides the arm, see PlanRequest: what carries the part turns its axis.
    """
    world = FineWorld(scene, q, s, others)
    p_tip = world.data.site_xpos[scene.tool_site].copy()
    direction = scene.part_motion(world.data, p_tip)
    if not scene.prismatic:
        joint = scene.joint_id
        direction = np.cross(world.data.xaxis[joint], p_tip - world.data.xanchor[joint])
    jacobian = ToolKinematics(scene, 0.0).jacobian(q)
    twist = np.concatenate([direction, np.zeros(3)])
    return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(6), twist)
