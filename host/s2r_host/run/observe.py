"""Look at the scene: one depth frame, the arm's own pixels marked, the object's points picked out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.link import Capture
from s2r_host.motion.robot_mask import robot_mask
from s2r_host.motion.scene import Scene, observed_scene
from s2r_host.run.session import Session


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
