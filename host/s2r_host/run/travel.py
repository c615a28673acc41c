"""Checked motions through free space, timed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.joint_motion import plan_joint_motion
from s2r_host.motion.obstacles import Obstacle
from s2r_host.run.session import Motion, Session
from s2r_host.trajectory import TimeLawSettings, time_law

AT_GOAL_RAD = 1e-3
FREE, LEAVING, NEVER = 0.0, 0.5, 1.0
"""A way through the air touches nothing from its beginning, a way out of contact nothing in its second half."""


def timed(session: Session, q_path: np.ndarray, label: str, speed: float, free_from: float = NEVER) -> Motion:
    """A joint path of shape (n, dof) as a motion within all limits.

    Args:
        session: For the arm.
        q_path: Where along.
        label: What it is called.
        speed: Share of the full one.
        free_from: Share of its time from which on it is to touch nothing.
    """
    return Motion(time_law(q_path, session.arm.arm, TimeLawSettings(speed=speed)), label, free_from)


def go_to(session: Session, q_goal: np.ndarray, obstacles: Sequence[Obstacle], label: str) -> bool:
    """Move to a posture by a checked way; False when already there.

    Raises:
        NoMotionError: No free way.
    """
    q_start = session.status().q_ref
    if np.abs(q_start - q_goal).max() < AT_GOAL_RAD:
        return False
    checker = CollisionChecker(session.arm, obstacles, Clearance())
    path = plan_joint_motion(checker, q_start, q_goal, session.rng, what=label)
    session.move([timed(session, path, label, session.settings.travel_speed, FREE)])
    return True
