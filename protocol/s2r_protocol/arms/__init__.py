"""Arm descriptions: one ``arm.yaml`` per arm, from which URDF, MJCF and limits are generated."""

from s2r_protocol.arms.description import ArmDescription, JointLimits, load_arm, shipped_arms
from s2r_protocol.arms.source import ArmDescriptionError

__all__ = ["ArmDescription", "ArmDescriptionError", "JointLimits", "load_arm", "shipped_arms"]
