"""The end of the finger that pushes: how wide and how deep it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.motion.arm_model import ArmModel

EDGE_ON = 1e-6  # a side that is parallel to the push has no foremost end


@dataclass(frozen=True)
class Fingertip:
    """A block about the tool's z axis; the tool frame's origin is the centre of its end.

    Attributes:
        width_m: Along the tool's x.
        depth_m: Along the tool's y.
    """

    width_m: float = 0.027
    depth_m: float = 0.015

    def ahead_m(self, R_base_tool: np.ndarray, direction: np.ndarray) -> float:
        """How far it reaches along a unit vector (3,), from the tool frame's origin [m]."""
        return 0.5 * float(np.abs(direction @ R_base_tool[:, :2]) @ (self.width_m, self.depth_m))

    def foremost_corner(self, R_base_tool: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """From the tool frame's origin to the part of the end that is foremost along a unit vector [m], (3,)."""
        corner = np.zeros(3)
        for axis, size in zip(R_base_tool.T, (self.width_m, self.depth_m), strict=False):
            if abs(axis @ direction) > EDGE_ON:
                corner += 0.5 * size * np.sign(axis @ direction) * axis
        return corner


CLOSED_GRIPPER = Fingertip()
"""Both fingers of the shipped gripper, closed."""


def fingertip_of(arm: ArmModel) -> Fingertip:
    """The fingertip of an arm by those shapes that its description names so; the shipped one where it names none."""
    if not arm.tip_shapes:
        return CLOSED_GRIPPER
    reach = np.zeros(2)
    for index in arm.tip_shapes:
        shape = arm.shapes.geometryObjects[index]
        X_tool_shape = arm.X_wrist_tool.inverse() * shape.placement
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        middle = X_tool_shape.act(0.5 * (box.min_ + box.max_))
        half = np.abs(X_tool_shape.rotation) @ (0.5 * (box.max_ - box.min_))
        reach = np.maximum(reach, (np.abs(middle) + half)[:2])
    return Fingertip(*(2.0 * reach).tolist())
