"""Leaving an object without moving it: back off from the contact, then out of the gap, then home."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_host.errors import NoMotionError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.cartesian import straight_line
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.inverse import InverseKinematics
from s2r_host.motion.joint_motion import plan_joint_motion
from s2r_host.motion.obstacles import Obstacle

BACK_OFF_M = (0.004, 0.006, 0.009, 0.014, 0.0)
OUT_M = (0.1, 0.07, 0.14, 0.05)


@dataclass(frozen=True, eq=False)
class Escape:
    """Joint paths of shape (n, dof): ``out`` leaves the object, ``home`` goes to the home posture.

    ``clearance_m`` is what ``out`` keeps to the modelled object once it has backed off.
    """

    out: np.ndarray
    home: np.ndarray
    clearance_m: float


def plan_escape(
    arm: ArmModel,
    near: Sequence[Obstacle],
    far: Sequence[Obstacle],
    q_start: np.ndarray,
    q_home: np.ndarray,
    push_direction: np.ndarray,
    rng: np.random.Generator,
) -> Escape:
    """A way home from a posture in contact.

    Args:
        arm: Kinematics.
        near: The object's shapes at its present state, and the table.
        far: Obstacles for the long way home (more clearance is kept to these).
        q_start: Posture in contact, shape (dof,).
        q_home: Where to end, shape (dof,).
        push_direction: The way the tip pressed on the object: the tip first backs off against it, shape (3,).
        rng: For the way home.

    Raises:
        NoMotionError: Every direction is blocked.
    """
    ik = InverseKinematics(arm)
    home_checker = CollisionChecker(arm, far, Clearance(obstacle_m=0.012, tip_m=0.01))
    blocked = 0
    last = "no direction is free"
    for margin_m in (0.003, 0.002, 0.001):
        tight = CollisionChecker(arm, near, Clearance(obstacle_m=margin_m, table_m=0.004, tip_m=margin_m))
        for p_back, p_out in _ways(arm.tool_pose(q_start), push_direction):
            out = _way_out(arm, ik, tight, q_start, p_back, p_out)
            if out is None:
                blocked += 1
                continue
            try:
                home = plan_joint_motion(home_checker, out[-1], q_home, rng, what="way home")
            except NoMotionError as error:
                last = str(error)
                continue
            return Escape(out, home, margin_m)
    raise NoMotionError(f"no way out of contact: {blocked} straight ways are blocked; {last}")


def _ways(X_base_tool: np.ndarray, push_direction: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(point after backing off, point outside) pairs, shortest and most upward first."""
    p = X_base_tool[:3, 3]
    back = -push_direction / np.linalg.norm(push_direction)
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(up, back)
    pull = -X_base_tool[:3, 2]  # out along the finger itself: the way it came in, more often than not
    for out_m in OUT_M:
        for back_m in BACK_OFF_M:
            p_back = p + back_m * back
            for direction in (pull, up, pull + up, up + 0.5 * back, side, -side, side + up, up - side, back):
                yield p_back, p_back + out_m * direction / np.linalg.norm(direction)


def _way_out(
    arm: ArmModel,
    ik: InverseKinematics,
    tight: CollisionChecker,
    q_start: np.ndarray,
    p_back: np.ndarray,
    p_out: np.ndarray,
) -> np.ndarray | None:
    """Back off and out; the first millimetres may touch (that is where the arm is), the rest must be free."""
    back = straight_line(arm, ik, q_start, p_back, spacing_m=0.002)
    if back is None or not tight.is_free(back[-1]):
        return None
    out = straight_line(arm, ik, back[-1], p_out)
    if out is None or not tight.path_is_free(out):
        return None
    return np.concatenate([back, out[1:]])
