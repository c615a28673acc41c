"""Joints and motors that are added to a model, with nothing of what its default classes say.

MuJoCo gives every new element the values of its class: friction, a range or a gear that the file states once for all
of the machine's own joints and motors.
"""

from __future__ import annotations

import mujoco

OF_JOINT = (
    "stiffness", "springref", "springdamper", "springyield", "damping", "frictionloss", "armature", "ref",
    "range", "margin", "solref_limit", "solimp_limit", "solref_friction", "solimp_friction",
    "actfrcrange", "actgravcomp",
)  # fmt: skip
OF_MOTOR = (
    "gear", "gaintype", "gainprm", "biastype", "biasprm", "dyntype", "dynprm", "actdim", "actearly", "armature",
    "damping", "delay", "nsample", "interp", "ctrlrange", "forcerange", "actrange", "ffrange", "velrange",
    "lengthrange", "cranklength", "inheritrange",
)  # fmt: skip
LIMITS_OF_JOINT, LIMITS_OF_MOTOR = ("limited", "actfrclimited"), ("ctrllimited", "forcelimited", "actlimited")


def coincident_joint(first: mujoco.MjsJoint, name: str) -> mujoco.MjsJoint:
    """Add a free joint without friction, inertia or spring, of the kind and on the axis of one that is there."""
    added = first.parent.add_joint(name=name, type=first.type, axis=first.axis, pos=first.pos)
    _neutral(added, mujoco.MjSpec().worldbody.add_joint(), OF_JOINT, LIMITS_OF_JOINT)
    return added


def plain_motor(spec: mujoco.MjSpec, name: str, joint: str) -> mujoco.MjsActuator:
    """Add a motor that passes its control on to a joint [N·m or N], whatever it is."""
    added = spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    _neutral(added, mujoco.MjSpec().add_actuator(), OF_MOTOR, LIMITS_OF_MOTOR)
    return added


def _neutral(
    added: mujoco.MjsJoint | mujoco.MjsActuator, plain: mujoco.MjsJoint | mujoco.MjsActuator,
    values: tuple[str, ...], limits: tuple[str, ...],
) -> None:  # fmt: skip
    """Take ``values`` from an element of an empty model, and switch ``limits`` off."""
    for key in values:
        setattr(added, key, getattr(plain, key))
    for key in limits:
        setattr(added, key, mujoco.mjtLimited.mjLIMITED_FALSE)
