"""Execution of chosen actions in the fine model, with every substep checked."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_host.planning.scene import GeomKind, Scene

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class Report:
    """What happened while the fine model ran.

    Attributes:
        contact: The first contact that was not fingertip against part, as "A against B at T s", or None.
        touched: The fingertip touched the part at some substep.
        torque_share: Largest actuator torque over its limit, gravity compensation included.
        torque_joint: Index of the joint where that was.
        press_N: Largest force of the fingertip on the part across the part's motion. It moves nothing; in a model
            with little friction it slides off an edge that it jams on in truth.
    """

    contact: str | None = None
    touched: bool = False
    torque_share: float = 0.0
    torque_joint: int = 0
    press_N: float = 0.0

    def merged(self, other: Report) -> Report:
        """This report followed by another."""
        worst = self if self.torque_share >= other.torque_share else other
        return Report(
            self.contact or other.contact,
            self.touched or other.touched,
            worst.torque_share,
            worst.torque_joint,
            max(self.press_N, other.press_N),
        )


class FineWorld:
    """The execution model and its state. Joint targets in, motion and a report out."""

    def __init__(self, scene: Scene, q_initial: np.ndarray, s_initial: float) -> None:
        """Args: scene; ``q_initial`` (dof,) [rad]; ``s_initial``, the object's joint [m or rad]. All at rest."""
        self.scene = scene
        self.data = mujoco.MjData(scene.fine)
        self.data.qpos[: scene.dof] = q_initial
        self.data.qpos[scene.s_qpos] = s_initial
        self.data.ctrl[: scene.dof] = q_initial
        self._tau_max = scene.arm.limits.tau_max
        self._kinds = scene.geom_kind
        mujoco.mj_forward(scene.fine, self.data)

    @property
    def s(self) -> float:
        """The object's joint [m or rad]."""
        return float(self.data.qpos[self.scene.s_qpos])

    @property
    def q(self) -> np.ndarray:
        """Joint positions [rad], (dof,)."""
        return self.data.qpos[: self.scene.dof].copy()

    def save(self) -> np.ndarray:
        """The whole state, for :meth:`restore`."""
        state = np.empty(mujoco.mj_stateSize(self.scene.fine, _STATE))
        mujoco.mj_getState(self.scene.fine, self.data, state, _STATE)
        return state

    def restore(self, state: np.ndarray) -> None:
        """Go back to a saved state."""
        mujoco.mj_setState(self.scene.fine, self.data, state, _STATE)

    def play(self, control: np.ndarray) -> Report:
        """Step once per row of ``control``, (substeps, dof): joint targets [rad] of the position servos."""
        model, data, dof = self.scene.fine, self.data, self.scene.dof
        contact: str | None = None
        touched, worst, joint, press_N = False, 0.0, 0, 0.0
        for row in control:
            data.ctrl[:dof] = row
            mujoco.mj_step(model, data)
            if data.ncon:
                touch, other = self._contacts()
                touched |= touch
                contact = contact or other
                if touch:
                    press_N = max(press_N, self._press())
            share = np.abs(data.qfrc_actuator[:dof]) / self._tau_max
            if share.max() > worst:
                joint = int(share.argmax())
                worst = float(share[joint])
        return Report(contact, touched, worst, joint, press_N)

    def check_now(self) -> Report:
        """Contacts at the present state, without stepping."""
        mujoco.mj_forward(self.scene.fine, self.data)
        touch, other = self._contacts() if self.data.ncon else (False, None)
        return Report(other, touch)

    def _press(self) -> float:
        """Force between fingertip and part across the part's motion [N], now."""
        model, data = self.scene.fine, self.data
        total = np.zeros(3)
        p_touch = np.zeros(3)
        touching = 0
        wrench = np.zeros(6)
        for i, pair in enumerate(data.contact.geom):
            first, second = self._kinds[pair]
            if {int(first), int(second)} != {int(GeomKind.PART), int(GeomKind.FINGER)}:
                continue
            mujoco.mj_contactForce(model, data, i, wrench)
            sign = 1.0 if second == GeomKind.PART else -1.0  # a contact's frame points from first to second
            total += sign * data.contact.frame[i].reshape(3, 3).T @ wrench[:3]
            p_touch += data.contact.pos[i]
            touching += 1
        if not touching:
            return 0.0
        motion = self.scene.part_motion(data, p_touch / touching)
        return float(np.linalg.norm(total - (total @ motion) * motion))

    def _contacts(self) -> tuple[bool, str | None]:
        """Whether the fingertip touches the part, and the first contact that is anything else."""
        pairs = self.data.contact.geom
        kinds = self._kinds[pairs]
        robot = kinds.max(axis=1) >= GeomKind.ROBOT
        if not robot.all():  # a scene's own things touch each other
            pairs, kinds = pairs[robot], kinds[robot]
            if not len(pairs):
                return False, None
        expected = (kinds.min(axis=1) == GeomKind.PART) & (kinds.max(axis=1) == GeomKind.FINGER)
        if expected.all():
            return True, None
        first, second = (self.scene.fine.geom(int(g)).name or f"geom {g}" for g in pairs[~expected][0])
        return bool(expected.any()), f"{first} against {second} at {self.data.time:.2f} s"
