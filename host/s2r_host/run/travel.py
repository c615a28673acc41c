"""Checked motions through free space, timed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from s2r_host.errors import NoMotionError
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.joint_motion import plan_joint_motion
from s2r_host.motion.leave import way_out_of_touch
from s2r_host.motion.obstacles import Obstacle
from s2r_host.run.observe import Observation
from s2r_host.run.session import Motion, Session
from s2r_host.trajectory import TimeLawSettings, TrajectoryError, time_law

AT_GOAL_RAD = 1e-3
# A motion may leave the corners of its path by TimeLawSettings.deviation_rad, 4 mrad in each joint. With TIP_M_PER_RAD
# that is 2.4 mm at the fingertip, and one joint alone on its longest lever, of an arm stretched out, makes 6.4 mm: both
# less than the centimetre and more that paths are checked with (motion.collision.Clearance). No bound follows from that
# for all joints at their worst in one direction on a stretched arm (25 mm); where a path keeps little, say clearance_m.
# How far smoothing takes the fingertip per radian that each joint may leave the path, at worst.
TIP_M_PER_RAD = 0.6
LEAST_DEVIATION_RAD = 0.5e-3  # sharper corners than that are hardly any nearer to the path, and slow
FREE, LEAVING, NEVER = 0.0, 0.5, 1.0
"""A way through the air touches nothing from its beginning, a way out of contact nothing in its second half."""


def timed(
    session: Session,
    q_path: np.ndarray,
    label: str,
    speed: float,
    free_from: float = NEVER,
    clearance_m: float = np.inf,
) -> Motion:
    """A joint path of shape (n, dof) as a motion within all limits.

    The motion rounds the path's corners: what was checked for collisions is left by up to half of ``clearance_m``, by
    more only where no narrower motion can be timed.

    Args:
        session: For the arm.
        q_path: Where along.
        label: What it is called.
        speed: Share of the full one.
        free_from: Share of its time from which on it is to touch nothing.
        clearance_m: What the path keeps to everything, where that is little.
    """
    usual, arm = TimeLawSettings(speed=speed), session.arm.arm
    deviation_rad = max(LEAST_DEVIATION_RAD, 0.5 * clearance_m / TIP_M_PER_RAD)
    while deviation_rad < usual.deviation_rad:
        try:
            narrow = replace(usual, deviation_rad=deviation_rad)
            return Motion(time_law(q_path, arm, narrow), label, free_from)
        except TrajectoryError:  # no speed leads round so sharp a corner
            deviation_rad *= 2.0
    return Motion(time_law(q_path, arm, usual), label, free_from)


def at_home(session: Session) -> bool:
    """Whether the arm stands at its home posture."""
    return bool(np.abs(session.status().q_ref - session.arm.arm.q_home).max() < AT_GOAL_RAD)


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


def leave_touch(session: Session, view: Observation, obstacles: Sequence[Obstacle]) -> None:
    """Bring an arm that was left in touch with something out of it, slowly; nothing where it touches nothing.

    A run that was interrupted while it pushed leaves its arm so.

    Args:
        session: Links.
        view: The newest look, without the robot.
        obstacles: What the next motion keeps clear of.

    Raises:
        NoMotionError: No straight way leads out.
        ArmStoppedError: The motion was stopped.
    """
    q_start = session.status().q_ref
    checker = CollisionChecker(session.arm, obstacles, Clearance())
    touched = checker.touching(q_start)
    if touched is None:
        return
    try:
        out = way_out_of_touch(checker, view.scene.p_base, q_start)
    except NoMotionError as error:
        raise NoMotionError(
            f"the arm begins in touch ({touched}), and {error}; play the way back that the run before recorded "
            "('s2r replay DIR --list', then 's2r replay DIR --real --plan N'), or take the object away"
        ) from error
    session.move([timed(session, out, "out of touch", session.settings.push_speed, LEAVING)])
    session.journal.warn(f"the arm began in touch ({touched}): it left along its finger, slowly")
