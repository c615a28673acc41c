"""Effects without a stock attribute, installed as a passive force callback with an off switch."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import mujoco
import numpy as np

from s2r_host.gap.effects.base import Context, Runtime, StepState
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.simulation.generic import forms


@dataclass(frozen=True)
class _Installed:
    """The patched model as equations of effects see a nominal one: its joints, in its order.

    Attributes:
        model: The patched model; it may have more joints, as behind a gear.
        adr, dof: Addresses of the joints in ``qpos`` and ``qvel``, shape (joint,).
    """

    model: mujoco.MjModel
    joints: tuple[str, ...]
    adr: np.ndarray
    dof: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: Sequence[str]) -> _Installed:
        found = [model.joint(name) for name in joints]
        adr, dof = (
            np.array([int(address[j.id]) for j in found]) for address in (model.jnt_qposadr, model.jnt_dofadr)
        )
        return cls(model, tuple(joints), adr, dof)

    def inverse(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """As :meth:`RigidModel.inverse`, joints that were added at their reference."""
        bare = copy.copy(self.model)
        bare.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        d, out = mujoco.MjData(bare), np.empty_like(q)
        for i in range(len(q)):
            d.qpos[self.adr], d.qvel[self.dof], d.qacc[self.dof] = q[i], dq[i], ddq[i]
            mujoco.mj_inverse(bare, d)
            out[i] = d.qfrc_inverse[self.dof]
        return out

    def state(self, d: mujoco.MjData, taken: np.ndarray) -> StepState:
        """What effects see; ``taken``: the effort that they took in the step before, shape (joint,)."""
        u = d.qfrc_actuator[self.dof] + d.qfrc_applied[self.dof]
        pushed = _of_wrenches(self.model, d)[self.dof]
        load = u + pushed - taken + d.qfrc_constraint[self.dof]
        return StepState(d.time, d.qpos[self.adr], d.qvel[self.dof], d.qacc[self.dof], u, pushed, load)


def _of_wrenches(model: mujoco.MjModel, d: mujoco.MjData) -> np.ndarray:
    """Efforts of the forces and torques applied to bodies, shape (nv,)."""
    out = np.zeros(model.nv)
    for body in np.flatnonzero(np.any(d.xfrc_applied, axis=1)):
        wrench = d.xfrc_applied[body]
        mujoco.mj_applyFT(model, d, wrench[:3], wrench[3:], d.xipos[body], int(body), out)
    return out


def install_terms(model: mujoco.MjModel, terms: list[dict], joints: Sequence[str]) -> Callable[[], None]:
    """Add the forces of ``terms`` to ``qfrc_passive`` of every simulation of ``model``.

    Args:
        model: The patched model; friction levels are written into its ``dof_frictionloss`` each step.
        terms: As written by ``s2r gap``: effect, number of the joint, shape, theta, given.
        joints: The joints that those numbers mean.

    Returns:
        A function that removes the callback and restores the friction levels.
    """
    installed = _Installed.of(model, joints)
    runtimes: list[tuple[int, Runtime]] = []
    for term in terms:
        ctx = Context(cast(RigidModel, installed), [], given=term["given"])
        made = forms()[term["effect"]].runtime(
            ctx, term["joint"], term["shape"], np.array(term["theta"]), float(model.opt.timestep)
        )
        if made is not None:
            runtimes.append((max(term["joint"], 0), made))
    friction, taken = np.array(model.dof_frictionloss), np.zeros(len(joints))
    previous = mujoco.get_mjcb_passive()

    def passive(m: mujoco.MjModel, d: mujoco.MjData) -> None:
        if previous is not None:
            previous(m, d)
        if m is not model:  # the callback is MuJoCo's own, for whatever it simulates
            return
        dry, state = friction.copy(), installed.state(d, taken)
        taken[:] = 0.0
        for joint, runtime in runtimes:
            effort, level = runtime(state)
            taken[joint] += effort
            dry[installed.dof[joint]] += level
        d.qfrc_passive[installed.dof] -= taken
        m.dof_frictionloss[:] = np.maximum(dry, 0.0)

    mujoco.set_mjcb_passive(passive)

    def off() -> None:
        mujoco.set_mjcb_passive(previous)
        model.dof_frictionloss[:] = friction

    return off
