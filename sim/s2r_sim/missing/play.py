"""A motion played with an effect on the object's joint and without: how far that effect shifts where the part ends."""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np

from s2r_sim.objects.effects import JointEffects
from s2r_sim.stability import StabilityWatch

Force = Callable[[float, float, float], tuple[float, float]]
"""(joint value, its speed, dry friction without the effect) -> (force on the joint, dry friction)."""
Servo = Callable[[mujoco.MjData, np.ndarray], None]
"""Hands a row of targets to whatever moves the arm."""

RELEASE_S = 1.0  # how long the part may move on by itself afterwards


def no_effect(s: float, v: float, dry: float) -> tuple[float, float]:
    """The joint as its model has it."""
    return 0.0, dry


def force_of(effects: JointEffects) -> Force:
    """What sealed effects do to the joint."""
    return lambda s, v, dry: (effects.force(s), effects.friction(dry, s, v))


def played(
    model: mujoco.MjModel, data: mujoco.MjData, joint: str, arm: np.ndarray, targets: np.ndarray, servo: Servo,
    force: Force,
) -> float:  # fmt: skip
    """Where the part ends with an effect on its joint [m or rad].

    The fingertip lets go at the end of the motion: the arm touches nothing any more for the last second.

    Args:
        model: Arm, object and table; as it was when this returns.
        data: How the motion begins.
        joint: Of the object.
        arm: Whether a geom is the arm's, (ngeom,) bool.
        targets: One row per step of the model.
        servo: Takes them.
        force: The effect.

    Raises:
        UnstableError: The model cannot be simulated any further.
    """
    q, v = int(model.joint(joint).qposadr[0]), int(model.joint(joint).dofadr[0])
    without = float(model.dof_frictionloss[v])
    contacts = model.geom_contype[arm].copy(), model.geom_conaffinity[arm].copy()
    stability = StabilityWatch(data)
    released = math.ceil(RELEASE_S / model.opt.timestep)
    try:
        for k, row in enumerate(np.concatenate([targets, np.repeat(targets[-1:], released, axis=0)])):
            if k == len(targets):
                model.geom_contype[arm] = model.geom_conaffinity[arm] = 0
            data.qfrc_applied[v], model.dof_frictionloss[v] = force(
                float(data.qpos[q]), float(data.qvel[v]), without
            )
            servo(data, row)
            mujoco.mj_step(model, data)
            stability.check()
    finally:
        model.dof_frictionloss[v] = without
        model.geom_contype[arm], model.geom_conaffinity[arm] = contacts
    return float(data.qpos[q])
