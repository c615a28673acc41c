"""What the rigid bodies of the model get wrong: motor inertia, payload, direction of gravity.

Sources: Siciliano et al., Robotics: Modelling, Planning and Control, section 7.2 (motor inertia J added to the
diagonal; load as a change of the last link's mass, first moment and inertia).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_conceal.effects.base import Effect, sign
from s2r_conceal.parameters import STANDARD_GRAVITY, Machine
from s2r_conceal.plant import Trace
from s2r_conceal.rigs.base import Rig


def _armature(machine: Machine, joint: int, values: dict[str, float], rig: Rig) -> Machine:
    extra = np.zeros_like(machine.armature)
    extra[joint] = values["inertia"]
    return replace(machine, armature=machine.armature + extra)


def _payload(machine: Machine, joint: int, values: dict[str, float], rig: Rig) -> Machine:
    p = rig.tip(machine) * values["reach"]
    return machine.with_point_mass(rig.joints - 1, values["mass"], p)


def _tilt(machine: Machine, joint: int, values: dict[str, float], rig: Rig) -> Machine:
    """Gravity turned by ``angle`` about the horizontal axis at ``heading`` (0: about +y)."""
    angle, heading = values["angle"] * values["direction"], values["heading"]
    sideways = np.sin(angle) * np.array([np.cos(heading), np.sin(heading), 0.0])
    gravity = np.linalg.norm(machine.gravity) * (sideways - np.cos(angle) * np.array([0.0, 0.0, 1.0]))
    return replace(machine, gravity=gravity)


def _acceleration(trace: Trace, joint: int, values: dict[str, float]) -> np.ndarray:
    """Where inertia shows: acceleration, smoothed over 30 ms."""
    kernel = np.hanning(31)
    dq = np.convolve(trace.dq[:, joint], kernel / kernel.sum(), mode="same")
    return np.gradient(dq)


def _everywhere(trace: Trace, joint: int, values: dict[str, float]) -> np.ndarray:
    return np.ones(len(trace.q))


EFFECTS = (
    Effect(
        "armature",
        lambda rng, c: {},
        "inertia",
        lambda c, _: (1e-3 * c.inertia, 1.0 * c.inertia),
        {"inertia": "kg·m²"},
        "in proportion to acceleration",
        machine=_armature,
        trace=_acceleration,
    ),
    Effect(
        "payload",
        lambda rng, c: {"reach": rng.uniform(0.7, 1.1)},
        "mass",
        lambda c, _: (1e-3 * c.gravity / STANDARD_GRAVITY, 2.0 * c.gravity / STANDARD_GRAVITY),
        {"mass": "kg", "reach": "1"},
        "everywhere, with gravity and acceleration",
        machine=_payload,
        trace=_everywhere,
        same_as=("spring_return",),
    ),
    Effect(
        "gravity_tilt",
        lambda rng, c: {"direction": sign(rng), "heading": 0.0},
        "angle",
        lambda c, _: (5e-4, 0.25),
        {"angle": "rad", "direction": "1", "heading": "rad"},
        "everywhere, with the pose",
        machine=_tilt,
        trace=_everywhere,
        same_as=("encoder_offset",),
    ),
)
