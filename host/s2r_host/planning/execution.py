"""Execution of chosen actions in the fine model, with every substep checked."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import mujoco.batch
import numpy as np

from s2r_host.planning.scene import GeomKind, Scene

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_STATE_SPEC, _CONTROL = _STATE, int(mujoco.mjtState.mjSTATE_CTRL)
_WARNINGS = "warnings"  # of each world: after the first one it was stepped no further


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
        contact_share: Largest joint torque that contact causes, over the joint's limit. The executor takes much of
            it for a collision.
    """

    contact: str | None = None
    touched: bool = False
    torque_share: float = 0.0
    torque_joint: int = 0
    press_N: float = 0.0
    contact_share: float = 0.0

    def merged(self, other: Report) -> Report:
        """This report followed by another."""
        worst = self if self.torque_share >= other.torque_share else other
        return Report(
            self.contact or other.contact,
            self.touched or other.touched,
            worst.torque_share,
            worst.torque_joint,
            max(self.press_N, other.press_N),
            max(self.contact_share, other.contact_share),
        )


class FineWorld:
    """The execution model and its state. Joint targets in, motion and a report out."""

    def __init__(
        self, scene: Scene, q_initial: np.ndarray, s_initial: float, others: np.ndarray | None = None
    ) -> None:
        """Args: scene; ``q_initial`` (dof,) [rad]; ``s_initial``, the object's joint [m or rad]; see PlanRequest.

        All at rest.
        """
        self.scene = scene
        self.data = mujoco.MjData(scene.fine)
        self.data.qpos[: scene.dof] = q_initial
        if others is not None:
            self.data.qpos[scene.dof :] = others
        self.data.qpos[scene.s_qpos] = s_initial
        self.data.ctrl[: scene.dof] = q_initial
        self._tau_max = scene.arm.limits.tau_max
        self._kinds = scene.geom_kind
        self._batch = mujoco.batch.Batch(scene.fine, nsim=1, nthread=1)
        mujoco.mj_forward(scene.fine, self.data)

    @property
    def s(self) -> float:
        """The object's joint [m or rad]."""
        return float(self.data.qpos[self.scene.s_qpos])

    @property
    def q(self) -> np.ndarray:
        """Joint positions [rad], (dof,)."""
        return self.data.qpos[: self.scene.dof].copy()

    @property
    def others(self) -> np.ndarray:
        """Positions of everything besides the arm, (nq - dof,)."""
        return self.data.qpos[self.scene.dof :].copy()

    def save(self) -> np.ndarray:
        """The whole state, for :meth:`restore`."""
        state = np.empty(mujoco.mj_stateSize(self.scene.fine, _STATE))
        mujoco.mj_getState(self.scene.fine, self.data, state, _STATE)
        return state

    def restore(self, state: np.ndarray) -> None:
        """Go back to a saved state; positions follow, forces and contacts do not."""
        mujoco.mj_setState(self.scene.fine, self.data, state, _STATE)
        mujoco.mj_kinematics(self.scene.fine, self.data)

    def play(self, control: np.ndarray) -> Report:
        """Step once per row of ``control``, (substeps, dof): joint targets [rad] of the position servos.

        Contacts are those of the states before each substep; the last state's are seen by the next call.
        """
        return self._follow(_stepped(self._batch, [self], control), 0)

    def _follow(self, record: dict, sim: int) -> Report:
        """Go to where one simulation of a record ended; what happened on the way."""
        states, sensors = record[_STATE_SPEC][sim], record["sensordata"][sim]
        dof = self.scene.dof
        touches, bad = self._contacts_of(sensors)
        share = np.abs(record["qfrc_actuator"][sim, :, :dof]) / self._tau_max
        worst = np.unravel_index(int(share.argmax()), share.shape)
        report = Report(None, bool(touches.any()), float(share[worst]), int(worst[1]))
        if report.touched:
            felt = np.abs(record["qfrc_constraint"][sim, touches, :dof]) / self._tau_max
            press_N = self._press(sensors[touches, self.scene.fine_contacts + 1 :].reshape(len(felt), -1, 7))
            report = replace(report, press_N=press_N, contact_share=float(felt.max()))
        if record["ncon"].size and bad is not None:
            report = replace(report, contact=self._name_contact(states, bad))
        self.restore(states[-1])
        if record[_WARNINGS][sim]:
            report = replace(report, contact=report.contact or "the fine model became unstable")
        return report

    def _contacts_of(self, sensors: np.ndarray) -> tuple[np.ndarray, int | None]:
        """Substeps at which the fingertip touches the part, bool (substeps,), and the first with any other contact."""
        at = self.scene.fine_contacts
        touches = sensors[:, at + 1 :: 7].sum(axis=1)
        bad = np.flatnonzero(sensors[:, at] > touches + 0.5)
        return touches > 0.0, int(bad[0]) if len(bad) else None

    def _press(self, finger: np.ndarray) -> float:
        """Largest force between fingertip and part across the part's motion [N], from sensors (n, fingers, 7)."""
        force_N = finger[..., 1:4].sum(axis=1)
        weight = finger[..., :1]
        p_touch = (weight * finger[..., 4:7]).sum(axis=1) / weight.sum(axis=1)
        motion = self.scene.part_motion(self.data, p_touch)
        along = (force_N * motion).sum(axis=1, keepdims=True) * motion
        return float(np.linalg.norm(force_N - along, axis=1).max())

    def _name_contact(self, states: np.ndarray, row: int) -> str:
        """Name the unexpected contact of the state before substep ``row``; leaves the present state behind."""
        if row > 0:
            self.restore(states[row - 1])
        mujoco.mj_forward(self.scene.fine, self.data)
        return self._contacts()[1] or f"contact of the robot at {self.data.time:.2f} s"

    def check_now(self) -> Report:
        """Contacts at the present state, without stepping."""
        mujoco.mj_forward(self.scene.fine, self.data)
        touch, other = self._contacts() if self.data.ncon else (False, None)
        return Report(other, touch)

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
        first, second = (self._name(int(geom)) for geom in pairs[~expected][0])
        return bool(expected.any()), f"{first} against {second} at {self.data.time:.2f} s"

    def _name(self, geom: int) -> str:
        """A geom by its name, or by its body's."""
        model = self.scene.fine
        return (
            model.geom(geom).name or f"geom {geom} of {model.body(model.geom_bodyid[geom]).name or 'a body'}"
        )


@dataclass(frozen=True, eq=False)
class Played:
    """What one of several worlds did, noted every so many substeps.

    Attributes:
        report: What happened on the way.
        t: Times [s], (m,).
        qpos, qvel: Positions and velocities then, (m, nq), (m, nv).
        tau: Torques of the arm's actuators in the substeps before, gravity compensation included [N·m], (m, dof).
        touch: The fingertip touched the part at the beginning of these, bool (m,).
    """

    report: Report
    t: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    tau: np.ndarray
    touch: np.ndarray


def play_side_by_side(worlds: list[FineWorld], control: np.ndarray, every: int, threads: int) -> list[Played]:
    """Step slightly different worlds with the same joint targets (substeps, dof) [rad], on several threads."""
    scene = worlds[0].scene
    batch = mujoco.batch.Batch(scene.fine, nsim=len(worlds), nthread=threads)
    batch.set_models([world.scene.fine for world in worlds])
    # Where the axis of the joint moves along with other things, its place is taken anew at each piece.
    piece = len(control) if scene.axis_stays else every
    nq, nv = scene.fine.nq, scene.fine.nv
    reports, notes = [Report()] * len(worlds), [[] for _ in worlds]
    for start in range(0, len(control), piece):
        some = control[start : start + piece]
        record = _stepped(batch, worlds, some)
        rows = np.minimum(np.arange(every - 1, len(some) + every - 1, every), len(some) - 1)
        for sim, world in enumerate(worlds):
            reports[sim] = reports[sim].merged(world._follow(record, sim))
            state, tau = record[_STATE_SPEC][sim, rows], record["qfrc_actuator"][sim, rows, : scene.dof]
            touch, _ = world._contacts_of(record["sensordata"][sim])
            notes[sim].append(
                (state[:, 0], state[:, 1 : 1 + nq], state[:, 1 + nq :][:, :nv], tau, touch[rows])
            )
    return [
        Played(report, *(np.concatenate(column) for column in zip(*noted, strict=True)))
        for report, noted in zip(reports, notes, strict=True)
    ]


def _stepped(batch: mujoco.batch.Batch, worlds: list[FineWorld], control: np.ndarray) -> dict:
    """Run a batch from the worlds' states, one step per row of control; what it recorded, (world, substeps, ...)."""
    scene = worlds[0].scene
    for sim, world in enumerate(worlds):
        batch.state[sim] = world.save()
    unused = scene.fine.nu - scene.dof
    if unused:
        control = np.concatenate([control, np.zeros((len(control), unused))], axis=1)
    batch.warning[:] = 0
    record: dict = batch.rollout(
        len(control),
        control,
        _CONTROL,
        (_STATE_SPEC, "sensordata", "qfrc_actuator", "qfrc_constraint", "ncon"),
    )
    record[_WARNINGS] = batch.warning[..., 1].sum(axis=1)
    return record
