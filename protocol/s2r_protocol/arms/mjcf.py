"""Arm source to MJCF text: the form MuJoCo loads, without actuators, friction or armature.

Whoever simulates the arm adds those through ``MjSpec``: the stand-in its drives, the planner its servos.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from s2r_protocol.arms.source import ArmSource, Box, Joint, Mount
from s2r_protocol.arms.urdf import axis_numbers, numbers

_PAINT = {"finger": "0.15 0.15 0.17 1", "gripper": "0.25 0.25 0.28 1"}
_PAINT_LINK = "0.85 0.86 0.88 1"


def to_mjcf(source: ArmSource) -> str:
    """Write the arm as MJCF: one body tree below the world, primitives only, site for the tool frame.

    ``eulerseq="XYZ"`` (extrinsic) makes MuJoCo read roll-pitch-yaw as URDF does.
    """
    root = ET.Element("mujoco", model=source.name)
    ET.SubElement(root, "compiler", angle="radian", eulerseq="XYZ", autolimits="true")
    world = ET.SubElement(root, "worldbody")
    _add_body(world, source, source.base, None)
    contact = ET.SubElement(root, "contact")
    # MuJoCo leaves neighbours out by itself, but not those of a body that stands.
    first = (source.joints[0].parent, source.joints[0].child)
    for a, b in dict.fromkeys((*source.collision_exclude, first)):
        ET.SubElement(contact, "exclude", body1=a, body2=b)
    keyframe = ET.SubElement(root, "keyframe")
    ET.SubElement(keyframe, "key", name="home", qpos=numbers(source.q_home))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add_body(parent: ET.Element, source: ArmSource, name: str, via: Joint | Mount | None) -> None:
    body = ET.SubElement(parent, "body", name=name)
    if via is not None:
        body.set("pos", numbers(via.origin))
    if isinstance(via, Mount):
        body.set("euler", numbers(via.rpy))
    link = source.link_named(name)
    inertial = ET.SubElement(body, "inertial", pos=numbers(link.com), mass=repr(link.mass))
    if any(link.products):  # principal moments, which whoever changes masses may scale
        moments, axes = np.linalg.eigh(link.tensor)
        inertial.set("diaginertia", numbers(moments.tolist()))
        inertial.set("xyaxes", numbers(axes.T[:2].ravel().tolist()))
    else:
        inertial.set("diaginertia", numbers(link.inertia))
    if isinstance(via, Joint):
        ET.SubElement(
            body, "joint", name=via.name, type="hinge", axis=axis_numbers(via), range=numbers(via.q)
        )
    for shape in source.shapes_of(name):
        paint = _PAINT.get(shape.name.split("_")[0], _PAINT_LINK)
        geom = ET.SubElement(body, "geom", name=shape.name, type=shape.type, rgba=paint)
        if isinstance(shape, Box):
            geom.set("pos", numbers(shape.center))
            geom.set("size", numbers(shape.half))
        else:
            geom.set("fromto", numbers((*shape.a, *shape.b)))
            geom.set("size", repr(shape.radius))
    tool = source.tool
    if tool.parent == name:
        ET.SubElement(
            body, "site", name=tool.name, pos=numbers(tool.origin), euler=numbers(tool.rpy), size="0.004"
        )
    for child in source.children_of(name):
        _add_body(body, source, child.child, child)
