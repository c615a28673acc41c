"""Look at the scene: one depth frame, the arm's own pixels marked, the object's points picked out."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from s2r_host.link import Capture
from s2r_host.motion.robot_mask import robot_mask
from s2r_host.motion.scene import Scene, observed_scene
from s2r_host.perception.colour_change import colour_moved
from s2r_host.run.session import Session

ARM_RIM_PX = 7  # about the arm's pixels: joints are measured while it settles
AROUND_PX = 20  # about the object's points


@dataclass(frozen=True, eq=False)
class Observation:
    """One look.

    Attributes:
        name: "A" before the first push, "B" after it, "C1", ... after each planned manipulation.
        capture: The frame.
        taken_s: When, since the run began.
        q_meas: The arm's joints meanwhile [rad], shape (dof,).
        arm_mask: Pixels that show the arm, shape (h, w), bool.
        scene: The object's points.
    """

    name: str
    capture: Capture
    taken_s: float
    q_meas: np.ndarray
    arm_mask: np.ndarray
    scene: Scene


def observe(session: Session, name: str) -> Observation:
    """Take a picture.

    Raises:
        EmptyCloudError: No object in view.
        PeerUnreachableError: Camera or executor silent.
    """
    capture = session.look(name)
    taken_s = session.journal.elapsed_s
    q_meas = session.status().q_meas
    mask = robot_mask(session.arm, q_meas, capture.frame)
    scene = observed_scene(capture.frame, mask, session.settings.region)
    return Observation(name, capture, taken_s, q_meas, mask, scene)


def seen_to_move(before: Observation, after: Observation) -> bool | None:
    """Whether the object moved between two looks, by colour; None where colours cannot tell."""
    arm = (before.arm_mask | after.arm_mask).astype(np.uint8)
    arm = cv2.dilate(arm, np.ones((2 * ARM_RIM_PX + 1,) * 2, np.uint8)) > 0
    return colour_moved(before.capture.frame, after.capture.frame, (_about(before) | _about(after)) & ~arm)


def _about(view: Observation) -> np.ndarray:
    """The box of the image around the object's points, shape (h, w), bool."""
    frame = view.capture.frame
    X = np.linalg.inv(frame.X_base_camera)
    p_C = view.scene.p_base @ X[:3, :3].T + X[:3, 3]
    uv = (p_C @ frame.K.T)[:, :2] / p_C[:, 2:]
    (left, top), (right, bottom) = uv.min(axis=0) - AROUND_PX, uv.max(axis=0) + AROUND_PX
    h, w = frame.depth_m.shape
    u, v = np.arange(w), np.arange(h)[:, None]
    return (u >= left) & (u <= right) & (v >= top) & (v <= bottom)
