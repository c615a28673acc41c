"""Model files for the tool under test: plain MJCF of a serial chain, the same layout for every case."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from s2r_conceal.parameters import Machine


@dataclass(frozen=True)
class Link:
    """One moving body of a chain: where its hinge sits in the parent, and about which axis it turns."""

    body: str
    joint: str
    axis: tuple[float, float, float]
    p_parent_m: tuple[float, float, float]


def numbers(values: np.ndarray | tuple[float, ...] | list[float]) -> str:
    """Space-separated numbers with seven digits."""
    return " ".join(f"{float(v) + 0.0:.7g}" for v in values)


def inertial(parent: ET.Element, mass_kg: float, com: np.ndarray, inertia: np.ndarray) -> None:
    """Write mass, centre of mass [m] and inertia about it [kg·m²] of one body."""
    full = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
    ET.SubElement(parent, "inertial", pos=numbers(com), mass=f"{mass_kg:.7g}", fullinertia=numbers(full))


def joint_attributes_of(machine: Machine, joint: int) -> dict[str, str]:
    """Armature, damping and dry friction of one joint, always written so that absence tells nothing."""
    return {
        "armature": f"{machine.armature[joint]:.7g}",
        "damping": f"{machine.viscous[joint]:.7g}",
        "frictionloss": f"{machine.coulomb[joint]:.7g}",
    }


def chain(links: list[Link], machine: Machine, joint_attributes: list[dict[str, str]]) -> str:
    """A serial chain of hinges with one torque motor each."""
    root = ET.Element("mujoco", model="rig")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(
        root, "option", timestep="0.001", integrator="implicitfast", gravity=numbers(machine.gravity)
    )
    parent = ET.SubElement(root, "worldbody")
    for i, link in enumerate(links):
        body = ET.SubElement(parent, "body", name=link.body, pos=numbers(link.p_parent_m))
        inertial(body, float(machine.mass[i]), machine.com[i], machine.inertia[i])
        attributes = {"name": link.joint, "type": "hinge", "axis": numbers(link.axis)}
        ET.SubElement(body, "joint", attributes | joint_attributes_of(machine, i) | joint_attributes[i])
        ET.SubElement(
            body,
            "geom",
            type="capsule",
            size="0.02",
            fromto=f"0 0 0 {numbers(2 * machine.com[i])}",
            contype="0",
            conaffinity="0",
            mass="0",
        )
        parent = body
    motors(root, [link.joint for link in links])
    return document(root)


def motors(root: ET.Element, joints: list[str]) -> None:
    """One unit-gear torque motor per joint."""
    actuator = ET.SubElement(root, "actuator")
    for joint in joints:
        ET.SubElement(actuator, "motor", name=f"motor_{joint}", joint=joint, gear="1")


def document(root: ET.Element) -> str:
    """The XML text, indented."""
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
