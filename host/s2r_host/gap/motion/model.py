"""The user's model: loading, its single-axis joints, and inverse dynamics over whole recordings."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.gap.errors import GapModelError
from s2r_host.gap.motion.model_files import find_files
from s2r_host.gap.motion.ties import Tie, led, ties_of
from s2r_host.gap.recordings.units import EFFORT_OF

FEW_JOINTS = 2  # more make an arm, whose links and frictions are weighed together (search/complete.py)

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)

_MATRIX = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # of fullinertia: xx, yy, zz, xy, xz, yz


def _listed(moments: np.ndarray) -> str:
    return ", ".join(f"{x:.4g}" for x in moments)


class RigidModel:
    """An MJCF or URDF with hinge and slide joints only.

    Attributes:
        joints: Joint names in order of their degree of freedom; index i below is this order.
        spec: The editable source, kept for patching.
        model: The compiled model; never modified (``variant`` makes copies).
        left_out: Sentences about what the file names and is not there.
        ties: Joints that others lead; :meth:`inverse` adds what they need to their leaders.
    """

    def __init__(self, path: Path) -> None:
        """Load a model file.

        Raises:
            GapModelError: The file is missing, does not compile, or has joints with several axes.
        """
        self.path = Path(path)
        if not self.path.is_file():
            raise GapModelError(f"model '{path}': no such file")
        try:
            self.spec, self.left_out = _read_spec(self.path)
            self.model = self.spec.compile()
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            text = " ".join(str(error).split())
            raise GapModelError(f"model '{self.path.name}' does not compile: {text[:300]}") from error
        m = self.model
        if m.njnt == 0:
            raise GapModelError(f"model '{self.path.name}' has no joint; there is nothing to compare")
        for i in range(m.njnt):
            if int(m.jnt_type[i]) not in (HINGE, SLIDE):
                raise GapModelError(
                    f"model '{self.path.name}': joint '{m.joint(i).name}' is neither hinge nor slide; "
                    "fix the floating base or remove the free body first"
                )
        self.joints = tuple(m.joint(i).name for i in range(m.njnt))
        self.ties: tuple[Tie, ...] = ties_of(m)
        self._inverse_model = self.variant(lambda _: None)
        self._data = mujoco.MjData(self._inverse_model)

    def index(self, joint: str) -> int:
        """Degree of freedom of a joint."""
        return self.joints.index(joint)

    def effort_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest effort the model's drives can put on each joint, infinite where unlimited.

        Limits on the joint itself and those of its actuators count; arrays of shape (joint,).
        """
        m = self.model
        low, high = np.full(m.nv, -np.inf), np.full(m.nv, np.inf)
        limited = np.flatnonzero(m.jnt_actfrclimited)
        low[limited], high[limited] = m.jnt_actfrcrange[limited].T
        # Numbers of tendons and sites, which other drives pull at, are counted on their own.
        on_joints = np.where(m.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT), m.actuator_trnid[:, 0], -1)
        for a, j in enumerate(on_joints.tolist()):
            if j < 0 or not m.actuator_forcelimited[a] or np.sum(on_joints == j) > 1:
                continue
            gear = float(m.actuator_gear[a, 0])
            ends = sorted(gear * m.actuator_forcerange[a])
            low[j], high[j] = max(low[j], ends[0]), min(high[j], ends[1])
        return low, high

    def inertia_replaced(self) -> list[str]:
        """Sentences about bodies whose stated inertia MuJoCo's ``balanceinertia`` has replaced by a sphere's.

        It does where one principal moment exceeds the sum of the others; a thin plate's rounded numbers are enough.
        """
        found = []
        for body in self.spec.bodies if self.spec.compiler.balanceinertia else []:
            has = np.sort(self.model.body_inertia[body.id])
            full = np.asarray(body.fullinertia)
            stated = np.sort(body.inertia) if np.isnan(full[0]) else np.linalg.eigvalsh(full[_MATRIX])
            if body.explicitinertial and not np.allclose(stated, has, rtol=1e-6):
                found.append(
                    f"model '{self.path.name}': 'balanceinertia' of its compiler has replaced the inertia of "
                    f"'{body.name}', {_listed(stated)}, by {_listed(has)} kg·m²: the first has a moment above the sum "
                    "of the other two. What is found of its inertia is that"
                )
        return found

    def unit(self, joint: str) -> str:
        """``rad`` or ``m``."""
        return "rad" if int(self.model.jnt_type[self.index(joint)]) == HINGE else "m"

    def effort_unit(self, joint: str) -> str:
        """``N·m`` or ``N``."""
        return EFFORT_OF[self.unit(joint)]

    def inertia_unit(self, joint: str, other: str | None = None) -> str:
        """Of what a joint feels of its own acceleration, or of that of another joint: ``kg·m²``, ``kg·m`` or ``kg``."""
        turning = sum(self.unit(j) == "rad" for j in (joint, other or joint))
        return ("kg", "kg·m", "kg·m²")[turning]

    def damping_unit(self, joint: str, other: str | None = None) -> str:
        """Of what a joint feels of its own speed, or of that of another joint, as ``N·m·s/rad``."""
        return f"{self.effort_unit(joint)}·s/{self.unit(other or joint)}"

    def friction_lead(self, joint: str) -> float:
        """How early MuJoCo's friction constraint turns round when the joint slows down [s]: 1/B of ``solreffriction``.

        MuJoCo, Computation, "Solver parameters": aref = -B v - K r, B = 2 / (dmax timeconst), or -damping / dmax.
        """
        m = self.model
        j = self.index(joint)
        constant, damping = (float(x) for x in m.dof_solref[j])
        largest = float(np.clip(m.dof_solimp[j, 1], 1e-4, 0.9999))
        if constant <= 0.0:
            return largest / max(-damping, 1e-9)
        return 0.5 * largest * max(constant, 2.0 * float(m.opt.timestep))

    def friction_slip(self, joint: str) -> float:
        """Speed over which MuJoCo's friction constraint builds up, per unit of friction [rad/s or m/s per N·m or N].

        The constraint is soft: f = -(B v + a) / R up to the friction loss, R = (1 - d) / d of the inverse inertia at
        the joint ("Solver parameters" as above). With a = 0 that is a slope of B / R.
        """
        m = self.model
        j = self.index(joint)
        smallest = float(np.clip(m.dof_solimp[j, 0], 1e-4, 0.9999))
        return (1.0 - smallest) / smallest * float(m.dof_invweight0[j]) * self.friction_lead(joint)

    def variant(self, change: Callable[[mujoco.MjModel], None]) -> mujoco.MjModel:
        """A copy for inverse dynamics (no contacts, limits or dry friction) with ``change`` applied."""
        m = copy.copy(self.model)
        m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        change(m)
        # Compiled short cuts (inertia of a plain slide, frames that coincide) hold the values before the change.
        m.body_simple[:], m.dof_simplenum[:], m.body_sameframe[:] = 0, 0, 0
        return m

    def inverse(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, variant: mujoco.MjModel | None = None
    ) -> np.ndarray:
        """Effort the model needs for a motion, without dry friction and contacts; of a leader also for its followers.

        Args:
            q: Positions, shape (time, joint); ``dq`` and ``ddq`` alike.
            variant: A model from :meth:`variant`; the nominal one by default.

        Returns:
            Efforts, shape (time, joint).
        """
        m = self._inverse_model if variant is None else variant
        d = self._data if variant is None else mujoco.MjData(variant)
        out = np.empty_like(q)
        qpos, qvel, qacc, result, inverse = d.qpos, d.qvel, d.qacc, d.qfrc_inverse, mujoco.mj_inverse
        for i in range(len(q)):
            qpos[:] = q[i]
            qvel[:] = dq[i]
            qacc[:] = ddq[i]
            inverse(m, d)
            out[i] = result
        return led(self.ties, q, out)

    def mass_diagonal(self, q: np.ndarray) -> np.ndarray:
        """Diagonal of the joint-space inertia, shape (time, joint), evaluated on at most 200 poses."""
        m, d = self._inverse_model, self._data
        picks = np.unique(np.linspace(0, len(q) - 1, min(200, len(q))).astype(int))
        rows = np.empty((len(picks), m.nv))
        full = np.zeros((m.nv, m.nv))
        for k, i in enumerate(picks):
            d.qpos[:] = q[i]
            mujoco.mj_fwdPosition(m, d)
            mujoco.mj_fullM(m, d, full)
            for tie in self.ties:
                slope = tie.slope(q[i, tie.leader])
                full[tie.leader] += slope * full[tie.follower]
                full[:, tie.leader] += slope * full[:, tie.follower]
            rows[k] = np.diag(full)
        grid = np.arange(len(q))
        return np.stack([np.interp(grid, picks, rows[:, j]) for j in range(m.nv)], axis=1)

    def subtree_bodies(self, joint: str) -> list[int]:
        """Bodies moved by a joint, the joint's own body first."""
        m = self.model
        root = int(m.jnt_bodyid[self.index(joint)])
        moved = [root]
        for b in range(root + 1, m.nbody):
            if int(m.body_parentid[b]) in moved:
                moved.append(b)
        return moved

    def joint_that_moves(self, body: int) -> str:
        """Name of the joint nearest to a body, between it and the base."""
        m = self.model
        while int(m.body_jntnum[body]) == 0:
            body = int(m.body_parentid[body])
        return self.joints[int(m.body_jntadr[body]) + int(m.body_jntnum[body]) - 1]

    def jointed_bodies(self) -> list[int]:
        """Bodies with mass that some joint moves."""
        m = self.model
        moved: set[int] = set()
        for joint in self.joints:
            moved.update(self.subtree_bodies(joint))
        return [b for b in sorted(moved) if m.body_mass[b] > 0]

    def body_name(self, body: int) -> str:
        """Name of a body; one that the file leaves nameless is called by its number."""
        return str(self.model.body(body).name)


def _read_spec(path: Path) -> tuple[mujoco.MjSpec, list[str]]:
    """A model file to be changed; bodies and joints that it leaves nameless are named by their numbers.

    Returns:
        The model, and sentences about what it names and is not there.

    Raises:
        ValueError: It does not compile.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    left_out = find_files(spec, path)
    spec.compile()
    for kind, elements in (("body", spec.bodies), ("joint", spec.joints)):
        taken = {element.name for element in elements}
        for element in elements:
            if not element.name:
                name = f"{kind}{element.id}"
                element.name = name if name not in taken else f"{name}_"
    return spec, left_out
