"""Effects without a stock attribute, installed as a passive force callback with an off switch."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Context, StepState


def install_terms(model: mujoco.MjModel, terms: list[dict]) -> Callable[[], None]:
    """Add the forces of ``terms`` to ``qfrc_passive`` of every simulation of ``model``.

    Args:
        model: The patched model; friction levels are written into its ``dof_frictionloss`` each step.
        terms: As written by ``s2r gap``: effect, joint, shape, theta, span.

    Returns:
        A function that removes the callback and restores the friction levels.
    """
    effects = catalogue()
    runtimes = []
    for term in terms:
        joint = model.joint(term["joint"])
        dof = int(model.jnt_dofadr[joint.id])
        rigid = SimpleNamespace(
            model=model, joints=[term["joint"]], unit=lambda _: "rad", effort_unit=lambda _: "N·m"
        )
        ctx = cast(
            Context, SimpleNamespace(model=rigid, sessions=[], span=lambda _, s=term["span"]: tuple(s))
        )
        made = effects[term["effect"]].runtime(
            ctx,
            0,
            term["shape"],
            np.array(term["theta"]),
            float(model.opt.timestep),
        )
        if made is not None:
            runtimes.append((dof, int(model.jnt_qposadr[joint.id]), made))
    friction = np.array(model.dof_frictionloss)
    previous = mujoco.get_mjcb_passive()

    def passive(m: mujoco.MjModel, d: mujoco.MjData) -> None:
        dry = friction.copy()
        for dof, adr, runtime in runtimes:
            u = d.qfrc_actuator[dof : dof + 1] + d.qfrc_applied[dof : dof + 1]
            load = u + d.qfrc_constraint[dof : dof + 1]
            state = StepState(
                d.time, d.qpos[adr : adr + 1], d.qvel[dof : dof + 1], d.qacc[dof : dof + 1], u, load
            )
            taken, level = runtime(state)
            d.qfrc_passive[dof] -= taken
            dry[dof] += level
        m.dof_frictionloss[:] = np.maximum(dry, 0.0)

    mujoco.set_mjcb_passive(passive)

    def off() -> None:
        mujoco.set_mjcb_passive(previous)
        model.dof_frictionloss[:] = friction

    return off
