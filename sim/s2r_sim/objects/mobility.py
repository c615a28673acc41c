"""Folders of PartNet-Mobility and Shape2Motion as plain data: links with shapes, joints, what they are called.

PartNet-Mobility (Xiang et al., "SAPIEN", CVPR 2020): ``mobility.urdf`` with meshes below ``textured_objs/`` and
``semantics.txt`` with lines "link_0 hinge door". Shape2Motion (Wang et al., CVPR 2019): ``part_objs/NAME.obj``
and ``motion_attributes.json``, a tree of parts with ``dof_name``, ``motion_type`` ("R", "T", "RT" or none),
``center`` and ``direction``. The data sets are not part of this project; their users bring their own copy.
An own object is a folder with one URDF of any name, z up.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from s2r_sim.errors import WorldFileError
from s2r_sim.objects.mobility_shapes import MeshPlace, Shape, numbers, origin, shapes_of

URDF, SEMANTICS = "mobility.urdf", "semantics.txt"
ATTRIBUTES, PARTS = "motion_attributes.json", "part_objs"
UNLIMITED = {"revolute": (-np.pi, np.pi), "prismatic": (0.0, 0.3)}  # [rad], [folder's units]


@dataclass(frozen=True, eq=False)
class MobileLink:
    """One rigid part.

    Attributes:
        name: As in the folder.
        meaning: What the data set calls it, e.g. "door".
        parent: Name of the link it moves against; None for the root.
        joint: "fixed", "revolute" or "prismatic".
        X_parent_link: Pose at joint value 0, shape (4, 4); the joint's axis passes its origin.
        axis: Unit vector in the link's frame, shape (3,).
        limits: Lower and upper joint value [rad or the folder's unit of length].
        shapes: What it consists of.
    """

    name: str
    meaning: str
    parent: str | None
    joint: str
    X_parent_link: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float]
    shapes: tuple[Shape, ...] = field(default=())


def read_mobility(folder: Path) -> tuple[MobileLink, ...]:
    """All links of a folder, parents before children; which data set it is shows in its files.

    Raises:
        WorldFileError: Neither layout, or a file of it cannot be used; the text names it.
    """
    file = urdf_of(folder)
    if file is not None:
        links = _read_urdf(file)
    elif (folder / ATTRIBUTES).is_file():
        links = _read_attributes(folder)
    else:
        raise WorldFileError(
            f"{folder} is no object folder: neither {URDF} (PartNet-Mobility) nor another single URDF nor {ATTRIBUTES} "
            "(Shape2Motion) is in it"
        )
    for link in links:
        for shape in link.shapes:
            if isinstance(shape, MeshPlace) and not shape.file.is_file():
                raise WorldFileError(
                    f"{folder}: link {link.name!r} names the mesh {shape.file}, which is missing"
                )
    return _parents_first(links, folder)


def urdf_of(folder: Path) -> Path | None:
    """The URDF of an object folder: PartNet-Mobility's, or the only one; None where there is none."""
    if (folder / URDF).is_file():
        return folder / URDF
    found = sorted(folder.glob("*.urdf"))
    return found[0] if len(found) == 1 else None


def _read_urdf(file: Path) -> list[MobileLink]:
    folder = file.parent
    try:
        robot = ET.parse(file).getroot()
    except ET.ParseError as error:
        raise WorldFileError(f"{file}: {error}") from error
    meanings = _semantics(folder / SEMANTICS)
    joints = {_reference(j, "child", file): j for j in robot.findall("joint")}
    links = []
    for element in robot.findall("link"):
        name = element.get("name", "")
        shapes = shapes_of(element, folder)
        joint = joints.get(name)
        if joint is None:
            links.append(
                MobileLink(name, meanings.get(name, ""), None, "fixed", np.eye(4), _Z, (0.0, 0.0), shapes)
            )
            continue
        kind = {"continuous": "revolute"}.get(joint.get("type", ""), joint.get("type", ""))
        if kind not in ("fixed", "revolute", "prismatic"):
            raise WorldFileError(
                f"{file}: joint {joint.get('name')!r} is {kind!r}; known are fixed, revolute, continuous and"
                " prismatic"
            )
        parent = _reference(joint, "parent", file)
        axis, limits = _axis(joint), _limits(joint, kind)
        links.append(
            MobileLink(name, meanings.get(name, ""), parent, kind, origin(joint), axis, limits, shapes)
        )
    return links


_Z = np.array([0.0, 0.0, 1.0])


def _semantics(file: Path) -> dict[str, str]:
    """Meaning per link: the last word of its line."""
    if not file.is_file():
        return {}
    rows = [line.split() for line in file.read_text().splitlines() if line.strip()]
    return {row[0]: row[-1] for row in rows if len(row) >= 2}


def _reference(joint: ET.Element, tag: str, file: Path) -> str:
    found = joint.find(tag)
    if found is None or not found.get("link"):
        raise WorldFileError(f"{file}: joint {joint.get('name')!r} names no {tag} link")
    return str(found.get("link"))


def _axis(joint: ET.Element) -> np.ndarray:
    tag = joint.find("axis")
    axis = numbers(None if tag is None else tag.get("xyz"), "1 0 0")
    return axis / max(float(np.linalg.norm(axis)), 1e-9)


def _limits(joint: ET.Element, kind: str) -> tuple[float, float]:
    tag = joint.find("limit")
    if kind == "fixed":
        return 0.0, 0.0
    if joint.get("type") == "continuous" or tag is None or tag.get("lower") is None:
        return UNLIMITED[kind]
    return float(tag.get("lower", "0")), float(tag.get("upper", "0"))


def _read_attributes(folder: Path) -> list[MobileLink]:
    try:
        tree = json.loads((folder / ATTRIBUTES).read_text())
    except json.JSONDecodeError as error:
        raise WorldFileError(f"{folder / ATTRIBUTES}: {error}") from error
    links: list[MobileLink] = []
    _add_parts(tree, None, np.zeros(3), folder, links)
    return links


def _add_parts(
    node: dict[str, Any], parent: str | None, p_parent: np.ndarray, folder: Path, links: list[MobileLink]
) -> None:
    """A part and those below it. All coordinates of the file are in one frame; links sit at their joint's centre."""
    try:
        name, motion = str(node["dof_name"]), str(node.get("motion_type", "none"))
        p = np.array(node["center"], dtype=float) if motion in ("R", "T", "RT") else np.zeros(3)
        axis = np.array(node["direction"], dtype=float) if motion in ("R", "T", "RT") else _Z
    except (KeyError, TypeError, ValueError) as error:
        raise WorldFileError(f"{folder / ATTRIBUTES}: a part lacks or misstates {error}") from error
    # A part that turns and slides is taken for one that turns.
    kind = {"R": "revolute", "RT": "revolute", "T": "prismatic"}.get(motion, "fixed")
    mesh, offset = np.eye(4), np.eye(4)
    mesh[:3, 3], offset[:3, 3] = -p, p - p_parent
    axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
    limits = UNLIMITED[kind] if kind != "fixed" else (0.0, 0.0)
    file = folder / PARTS / f"{'none_motion' if parent is None else name}.obj"
    links.append(MobileLink(name, name, parent, kind, offset, axis, limits, (MeshPlace(file, mesh),)))
    for child in node.get("children", []):
        _add_parts(child, name, p, folder, links)


def _parents_first(links: list[MobileLink], folder: Path) -> tuple[MobileLink, ...]:
    known: set[str | None] = {None}
    left, done = list(links), []
    while left:
        ready = [link for link in left if link.parent in known]
        if not ready:
            raise WorldFileError(f"{folder}: links {', '.join(link.name for link in left)} hang on no root")
        known |= {link.name for link in ready}
        done += ready
        left = [link for link in left if link.parent not in known or link.name not in known]
    return tuple(done)
