"""The arm as the motion code sees it: forward kinematics, Jacobian and collision shapes (Pinocchio)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from s2r_protocol.arms import ArmDescription
from s2r_protocol.arms.source import FINGER_PREFIX

LIMIT_MARGIN_RAD = 0.02


@dataclass(frozen=True, eq=False)
class ArmModel:
    """Kinematics and shapes of one arm. Not thread-safe: it owns one Pinocchio workspace."""

    arm: ArmDescription

    @cached_property
    def model(self) -> pin.Model:
        """Pinocchio model; joint order is the arm's."""
        return pin.buildModelFromXML(self.arm.urdf)

    @cached_property
    def data(self) -> pin.Data:
        """Workspace of :attr:`model`."""
        return self.model.createData()

    @cached_property
    def shapes(self) -> pin.GeometryModel:
        """The arm's primitive collision shapes, without pairs."""
        return pin.buildGeomFromUrdfString(self.model, self.arm.urdf, pin.GeometryType.COLLISION)

    @cached_property
    def tool_id(self) -> int:
        """Frame index of the fingertip."""
        return self.model.getFrameId(self.arm.tool_frame, pin.FrameType.BODY)

    @cached_property
    def q_min(self) -> np.ndarray:
        """Lower joint limits with a margin [rad], shape (dof,)."""
        return self.arm.limits.q_min + LIMIT_MARGIN_RAD

    @cached_property
    def q_max(self) -> np.ndarray:
        """Upper joint limits with a margin [rad], shape (dof,)."""
        return self.arm.limits.q_max - LIMIT_MARGIN_RAD

    def inside_limits(self, q: np.ndarray) -> bool:
        """Whether every joint keeps the margin to its limits."""
        return bool(np.all(q >= self.q_min) and np.all(q <= self.q_max))

    def tool_pose(self, q: np.ndarray) -> np.ndarray:
        """X_base_tool at q, shape (4, 4)."""
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.data.oMf[self.tool_id].homogeneous.copy()

    def link_of(self, shape_index: int) -> str:
        """Name of the link a shape belongs to."""
        return self.model.frames[self.shapes.geometryObjects[shape_index].parentFrame].name

    def shape_placements(self, q: np.ndarray) -> list[pin.SE3]:
        """Pose of every collision shape in the base frame at q."""
        data = self.shapes.createData()
        pin.updateGeometryPlacements(self.model, self.data, self.shapes, data, q)
        return [pin.SE3(data.oMg[i]) for i in range(self.shapes.ngeoms)]

    @cached_property
    def X_wrist_tool(self) -> pin.SE3:
        """The tool frame as seen from the last joint, which carries it."""
        return pin.SE3(self.model.frames[self.tool_id].placement)

    @cached_property
    def hand_shapes(self) -> frozenset[int]:
        """Shapes that the last joint carries, as it does the tool frame."""
        wrist = self.model.frames[self.tool_id].parentJoint
        return frozenset(
            i for i, shape in enumerate(self.shapes.geometryObjects) if shape.parentJoint == wrist
        )

    @cached_property
    def tip_shapes(self) -> frozenset[int]:
        """Shapes of the fingertip: those that the description calls so, the only ones meant to touch."""
        names = {
            f"{link.get('name')}_{k}": collision.get("name", "")
            for link in ET.fromstring(self.arm.urdf).iter("link")
            for k, collision in enumerate(link.iter("collision"))
        }
        shapes = self.shapes.geometryObjects
        return frozenset(i for i, s in enumerate(shapes) if names[s.name].startswith(FINGER_PREFIX))

    @cached_property
    def lever_m(self) -> np.ndarray:
        """Largest distance of the fingertip from each joint's axis [m], shape (dof,), an upper bound.

        The lengths of the links from there on: the arm stretched, whatever posture its description has at zero.
        """
        links = [self.model.jointPlacements[i].translation for i in range(2, self.model.njoints)]
        lengths = np.linalg.norm([*links, self.X_wrist_tool.translation], axis=1)
        return np.cumsum(lengths[::-1])[::-1]
