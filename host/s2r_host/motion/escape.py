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

BACK_OFF_M = (0.005, 0.008, 0.012, 0.003, 0.018, 0.0)
ASIDE_M = (0.0, 0.006, -0.006, 0.012, -0.012)
OUT_M = (0.1, 0.07, 0.14, 0.05)
MARGINS_M = (0.003, 0.002, 0.001)
TOUCHING_M = 0.006
LARGEST_STEP_RAD = 0.3
UPRIGHT_SIN = 1e-3


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
    way_in: np.ndarray | None = None,
    carried: np.ndarray | None = None,
) -> Escape:
    """A way home from a posture in contact: back off and straight out, else the way it came.

    Args:
        arm: Kinematics.
        near: The object's shapes at its present state, and the table.
        far: Obstacles for the long way home (more clearance is kept to these).
        q_start: Posture in contact, shape (dof,).
        q_home: Where to end, shape (dof,).
        push_direction: The way the tip pressed on the object: the tip first backs off against it, shape (3,).
        rng: For the way home.
        way_in: Joint path by which the tip got to the object, shape (n, dof), if there was one.
        carried: What the touched part's motion since then did to it, base frame, shape (4, 4).

    Raises:
        NoMotionError: Every direction is blocked.
    """
    ik = InverseKinematics(arm)
    home_checker = CollisionChecker(arm, far, Clearance(obstacle_m=0.012, tip_m=0.01))
    blocked = 0
    last = "no direction is free"
    for margin_m in MARGINS_M:
        tight = _tight(arm, near, margin_m)
        for back in _ways_back(arm, ik, tight, q_start, push_direction):
            for out in _ways_out(arm, ik, tight, back[-1], push_direction):
                try:
                    home = plan_joint_motion(home_checker, out[-1], q_home, rng, what="way home")
                except NoMotionError as error:
                    last = str(error)
                    continue
                return Escape(np.concatenate([back, out[1:]]), home, margin_m)
            blocked += 1
    if way_in is not None and carried is not None:
        out = _way_it_came(arm, ik, near, q_start, way_in, carried)
        if out is not None:
            return Escape(out, plan_joint_motion(home_checker, out[-1], q_home, rng, what="way home"), 0.0)
        last = "the way it came is not free either"
    raise NoMotionError(f"no way out of contact: {blocked} places beside the contact lead nowhere; {last}")


def _tight(arm: ArmModel, near: Sequence[Obstacle], margin_m: float) -> CollisionChecker:
    return CollisionChecker(arm, near, Clearance(obstacle_m=margin_m, table_m=0.004, tip_m=margin_m))


def _way_it_came(
    arm: ArmModel,
    ik: InverseKinematics,
    near: Sequence[Obstacle],
    q_start: np.ndarray,
    way_in: np.ndarray,
    carried: np.ndarray,
) -> np.ndarray | None:
    """The way in, backwards and carried along with the part; None when it is not free or out of reach."""
    checker = _tight(arm, near, 0.0)
    path = [np.asarray(q_start, float)]
    p_start = arm.tool_pose(q_start)[:3, 3]
    for q_in in way_in[::-1]:
        X = carried @ arm.tool_pose(q_in)
        if np.linalg.norm(X[:3, 3] - arm.tool_pose(path[-1])[:3, 3]) < 0.002:
            continue
        q = ik.solve(X, path[-1], iterations=30)
        if q is None or np.abs(q - path[-1]).max() > LARGEST_STEP_RAD:
            return None
        # The first millimetres touch: that is where the arm is.
        if np.linalg.norm(X[:3, 3] - p_start) > TOUCHING_M and not checker.line_is_free(path[-1], q):
            return None
        path.append(q)
        if np.linalg.norm(X[:3, 3] - p_start) > OUT_M[0]:
            return np.array(path)
    return None


def _ways_back(
    arm: ArmModel,
    ik: InverseKinematics,
    tight: CollisionChecker,
    q_start: np.ndarray,
    push_direction: np.ndarray,
) -> Iterator[np.ndarray]:
    """Joint paths of a few millimetres to places that are free; the way there may touch, that is where the arm is."""
    p = arm.tool_pose(q_start)[:3, 3]
    back = -push_direction / np.linalg.norm(push_direction)
    side = _aside(back)
    for aside_m in ASIDE_M:
        for back_m in BACK_OFF_M:
            path = straight_line(arm, ik, q_start, p + back_m * back + aside_m * side, spacing_m=0.002)
            if path is not None and tight.is_free(path[-1]):
                yield path


def _aside(back: np.ndarray) -> np.ndarray:
    """A level unit vector across a unit vector (3,); across x where that is upright, as the push on a lid may be."""
    side = np.cross([0.0, 0.0, 1.0], back)
    length = float(np.linalg.norm(side))
    return side / length if length > UPRIGHT_SIN else np.array([0.0, 1.0, 0.0])


def _ways_out(
    arm: ArmModel,
    ik: InverseKinematics,
    tight: CollisionChecker,
    q_back: np.ndarray,
    push_direction: np.ndarray,
) -> Iterator[np.ndarray]:
    """Free straight joint paths away from the object, the most natural directions first."""
    X = arm.tool_pose(q_back)
    back = -push_direction / np.linalg.norm(push_direction)
    up, side = np.array([0.0, 0.0, 1.0]), _aside(back)
    pull = -X[:3, 2]  # out along the finger itself: the way it came in, more often than not
    for out_m in OUT_M:
        for direction in (pull, up, pull + up, up + 0.5 * back, side, -side, side + up, up - side, back):
            path = straight_line(arm, ik, q_back, X[:3, 3] + out_m * direction / np.linalg.norm(direction))
            if path is not None and tight.path_is_free(path):
                yield path
