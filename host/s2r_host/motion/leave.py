"""Out of touch with what a camera sees, for an arm that was left there: nothing is known of the way it came."""

from __future__ import annotations

import coal
import numpy as np

from s2r_host.errors import NoMotionError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.cartesian import straight_line
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.inverse import InverseKinematics
from s2r_host.motion.obstacles import VOXEL_M, cloud_obstacle, table_obstacle, voxels

TOUCHING_M = 0.02  # what is seen nearer to the hand than this is what it touches: the way may begin in it
OUT_M = (0.1, 0.15, 0.06)


def way_out_of_touch(checker: CollisionChecker, p_base: np.ndarray, q_start: np.ndarray) -> np.ndarray:
    """A straight way of the fingertip from among what it touches to a posture that is free.

    Along the finger comes first: so it came in, more often than not. Only what the hand touches now may be near the
    way, and nothing may be where it ends.

    Args:
        checker: What the arm has to be free of where the way ends.
        p_base: Observed points, base frame [m], (n, 3).
        q_start: Posture in touch [rad], (dof,).

    Returns:
        Joint path from ``q_start`` on [rad], (n, dof).

    Raises:
        NoMotionError: No direction leads out.
    """
    arm, cells = checker.arm, voxels(p_base)
    others = cells[_apart_from_hand(arm, cells, q_start) > TOUCHING_M]
    on_the_way = CollisionChecker(
        arm, [table_obstacle(), cloud_obstacle(others)], Clearance(obstacle_m=0.0, table_m=0.0, tip_m=0.0)
    )
    ik, X = InverseKinematics(arm), arm.tool_pose(q_start)
    back, up = -X[:3, 2], np.array([0.0, 0.0, 1.0])
    for direction in (back, back + up, up, 2.0 * back + up):
        for out_m in OUT_M:
            path = straight_line(arm, ik, q_start, X[:3, 3] + out_m * direction / np.linalg.norm(direction))
            if path is not None and on_the_way.path_is_free(path) and checker.is_free(path[-1]):
                return path
    raise NoMotionError("no straight way of the fingertip leads out of what the arm touches")


def _apart_from_hand(arm: ArmModel, cells: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Distances of voxels from the shapes that the last joint carries [m], (n,); zero and less: inside."""
    placements, voxel = arm.shape_placements(q), coal.Box(VOXEL_M, VOXEL_M, VOXEL_M)
    request, apart = coal.DistanceRequest(), np.full(len(cells), np.inf)
    for i in arm.hand_shapes:
        shape = arm.shapes.geometryObjects[i].geometry
        shape.computeLocalAABB()
        here = coal.Transform3s(placements[i].rotation, placements[i].translation)
        reach = np.linalg.norm(cells - placements[i].translation, axis=1) - shape.aabb_radius
        for k in np.flatnonzero(reach < TOUCHING_M + VOXEL_M):
            there = coal.Transform3s(np.eye(3), cells[k])
            apart[k] = min(apart[k], coal.distance(shape, here, voxel, there, request, coal.DistanceResult()))
    return apart
