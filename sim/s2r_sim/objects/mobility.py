"""Folders of PartNet-Mobility and Shape2Motion as plain data: links with meshes, joints, what they are called.

PartNet-Mobility (Xiang et al., "SAPIEN", CVPR 2020): ``mobility.urdf`` with meshes below ``textured_objs/`` and
``semantics.txt`` with lines "link_0 hinge door". Shape2Motion (Wang et al., CVPR 2019): ``part_objs/NAME.obj``
and ``motion_attributes.json``, a tree of parts with ``dof_name``, ``motion_type`` ("R", "T", "RT" or none),
``center`` and ``direction``. The data sets are not part of this project; their users bring their own copy.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from s2r_sim.errors import WorldFileError

URDF, SEMANTICS = "mobility.urdf", "semantics.txt"
ATTRIBUTES, PARTS = "motion_attributes.json", "part_objs"
UNLIMITED = {"revolute": (-np.pi, np.pi), "prismatic": (0.0, 0.3)}  # [rad], [folder's units]


@dataclass(frozen=True, eq=False)
class MeshPlace:
    """A mesh file and where its frame sits in its link's frame (4, 4)."""

    file: Path
    X_link_mesh: np.ndarray


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
        meshes: What it consists of.
    """

    name: str
    meaning: str
    parent: str | None
    joint: str
    X_parent_link: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float]
    meshes: tuple[MeshPlace, ...] = field(default=())


def read_mobility(folder: Path) -> tuple[MobileLink, ...]:
    """All links of a folder, parents before children; which data set it is shows in its files.

    Raises:
        WorldFileError: Neither layout, or a file of it cannot be used; the text names it.
    """
    if (folder / URDF).is_file():
        links = _read_urdf(folder)
    elif (folder / ATTRIBUTES).is_file():
        links = _read_attributes(folder)
    else:
        raise WorldFileError(
            f"{folder} is no object folder: neither {URDF} (PartNet-Mobility) nor {ATTRIBUTES} (Shape2Motion) is in it"
        )
    for link in links:
        for mesh in link.meshes:
            if not mesh.file.is_file():
                raise WorldFileError(
                    f"{folder}: link {link.name!r} names the mesh {mesh.file}, which is missing"
                )
    return _parents_first(links, folder)


def _read_urdf(folder: Path) -> list[MobileLink]:
    try:
        robot = ET.parse(folder / URDF).getroot()
    except ET.ParseError as error:
        raise WorldFileError(f"{folder / URDF}: {error}") from error
    meanings = _semantics(folder / SEMANTICS)
    joints = {_reference(j, "child", folder): j for j in robot.findall("joint")}
    links = []
    for element in robot.findall("link"):
        name = element.get("name", "")
        meshes = tuple(
            MeshPlace(folder / mesh.get("filename", ""), _origin(visual))
            for visual in element.findall("visual")
            if (mesh := visual.find("geometry/mesh")) is not None
        )
        joint = joints.get(name)
        if joint is None:
            links.append(
                MobileLink(name, meanings.get(name, ""), None, "fixed", np.eye(4), _Z, (0.0, 0.0), meshes)
            )
            continue
        kind = {"continuous": "revolute"}.get(joint.get("type", ""), joint.get("type", ""))
        if kind not in ("fixed", "revolute", "prismatic"):
            raise WorldFileError(
                f"{folder / URDF}: joint {joint.get('name')!r} is {kind!r}; known are fixed, revolute, continuous and"
                " prismatic"
            )
        parent = _reference(joint, "parent", folder)
        axis, limits = _axis(joint), _limits(joint, kind)
        links.append(
            MobileLink(name, meanings.get(name, ""), parent, kind, _origin(joint), axis, limits, meshes)
        )
    return links


_Z = np.array([0.0, 0.0, 1.0])


def _semantics(file: Path) -> dict[str, str]:
    """Meaning per link: the last word of its line."""
    if not file.is_file():
        return {}
    rows = [line.split() for line in file.read_text().splitlines() if line.strip()]
    return {row[0]: row[-1] for row in rows if len(row) >= 2}


def _reference(joint: ET.Element, tag: str, folder: Path) -> str:
    found = joint.find(tag)
    if found is None or not found.get("link"):
        raise WorldFileError(f"{folder / URDF}: joint {joint.get('name')!r} names no {tag} link")
    return str(found.get("link"))


def _numbers(text: str | None, fallback: str) -> np.ndarray:
    return np.array([float(word) for word in (text or fallback).split()])


def _origin(element: ET.Element) -> np.ndarray:
    """Pose (4, 4) of an ``origin`` tag; roll, pitch, yaw about fixed axes as in URDF."""
    X = np.eye(4)
    tag = element.find("origin")
    if tag is None:
        return X
    (r, p, y) = _numbers(tag.get("rpy"), "0 0 0")
    Rx = np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    Ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    Rz = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    X[:3, :3], X[:3, 3] = Rz @ Ry @ Rx, _numbers(tag.get("xyz"), "0 0 0")
    return X


def _axis(joint: ET.Element) -> np.ndarray:
    tag = joint.find("axis")
    axis = _numbers(None if tag is None else tag.get("xyz"), "1 0 0")
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
