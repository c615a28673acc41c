"""Arm source to URDF text: the form Pinocchio, yourdfpy and ROS tools load."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from s2r_protocol.arms.source import ArmSource, Box, Joint, Link, Rod


def to_urdf(source: ArmSource) -> str:
    """Write the arm as URDF.

    URDF knows no capsule: a capsule becomes a cylinder named ``…_rod`` and two spheres ``…_end0``, ``…_end1``.
    The tool frame is a link without mass.
    """
    robot = ET.Element("robot", name=source.name)
    for link in source.links:
        _add_link(robot, source, link)
    for joint in source.joints:
        _add_joint(robot, joint)
    for mount in source.mounts:
        _add_fixed(
            robot, f"{mount.parent}_to_{mount.child}", mount.parent, mount.child, mount.origin, mount.rpy
        )
    tool = source.tool
    ET.SubElement(robot, "link", name=tool.name)
    _add_fixed(robot, f"{tool.parent}_to_{tool.name}", tool.parent, tool.name, tool.origin, tool.rpy)
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def numbers(values: Sequence[float]) -> str:
    """Numbers that read back to the same bits."""
    return " ".join(repr(float(v)) for v in values)


def axis_numbers(joint: Joint) -> str:
    """The direction of a joint's axis, whole numbers where it is one of the frame's."""
    return " ".join(repr(int(v) if v in (-1.0, 0.0, 1.0) else v) for v in joint.direction)


def _add_link(robot: ET.Element, source: ArmSource, link: Link) -> None:
    element = ET.SubElement(robot, "link", name=link.name)
    inertial = ET.SubElement(element, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(link.com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(link.mass))
    ixx, iyy, izz = (repr(v) for v in link.inertia)
    ixy, ixz, iyz = (repr(v) if v else "0" for v in link.products)
    ET.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy=ixy, ixz=ixz, iyz=iyz)
    for shape in source.shapes_of(link.name):
        for tag in ("visual", "collision"):
            if isinstance(shape, Box):
                _add_box(element, tag, shape)
            else:
                _add_rod(element, tag, shape)


def _add_box(element: ET.Element, tag: str, box: Box) -> None:
    geometry = _add_geometry(element, tag, box.name, box.center, (0.0, 0.0, 0.0))
    ET.SubElement(geometry, "box", size=numbers([2 * h for h in box.half]))


def _add_rod(element: ET.Element, tag: str, rod: Rod) -> None:
    a, b = np.asarray(rod.a), np.asarray(rod.b)
    length = float(np.linalg.norm(b - a))
    name = rod.name if rod.type == "cylinder" else f"{rod.name}_rod"
    geometry = _add_geometry(element, tag, name, (a + b) / 2, _rpy_of_z_along(b - a))
    ET.SubElement(geometry, "cylinder", radius=repr(rod.radius), length=repr(length))
    if rod.type == "capsule":
        for i, end in enumerate((a, b)):
            geometry = _add_geometry(element, tag, f"{rod.name}_end{i}", end, (0.0, 0.0, 0.0))
            ET.SubElement(geometry, "sphere", radius=repr(rod.radius))


def _add_geometry(
    element: ET.Element, tag: str, name: str, xyz: Sequence[float] | np.ndarray, rpy: Sequence[float]
) -> ET.Element:
    shape = ET.SubElement(element, tag, name=name)
    ET.SubElement(shape, "origin", xyz=numbers(list(xyz)), rpy=numbers(rpy))
    return ET.SubElement(shape, "geometry")


def _rpy_of_z_along(direction: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch, yaw of a frame whose z axis points along ``direction``."""
    x, y, z = direction / np.linalg.norm(direction)
    return 0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)) if np.hypot(x, y) > 0 else 0.0


def _add_joint(robot: ET.Element, joint: Joint) -> None:
    element = ET.SubElement(robot, "joint", name=joint.name, type="revolute")
    ET.SubElement(element, "origin", xyz=numbers(joint.origin), rpy="0 0 0")
    ET.SubElement(element, "parent", link=joint.parent)
    ET.SubElement(element, "child", link=joint.child)
    ET.SubElement(element, "axis", xyz=axis_numbers(joint))
    lower, upper = (repr(v) for v in joint.q)
    ET.SubElement(
        element, "limit", lower=lower, upper=upper, velocity=repr(joint.dq_max), effort=repr(joint.tau_max)
    )


def _add_fixed(
    robot: ET.Element, name: str, parent: str, child: str, origin: Sequence[float], rpy: Sequence[float]
) -> None:
    element = ET.SubElement(robot, "joint", name=name, type="fixed")
    ET.SubElement(element, "origin", xyz=numbers(origin), rpy=numbers(rpy))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
