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

from s2r_protocol.arms.urdf_tags import origin, triple
from s2r_sim.errors import WorldFileError
from s2r_sim.objects.mobility_shapes import MeshPlace, Shape, shapes_of

URDF, SEMANTICS = "mobility.urdf", "semantics.txt"
ATTRIBUTES, PARTS = "motion_attributes.json", "part_objs"
WIDEST_TURN_RAD = 4 * np.pi  # of a hinge; numbers of degrees are larger
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
                    f"{folder}: link {link.name!r} names the mesh {shape.file}, which is missing; meshes are named from"
                    " that folder"
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
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter two: an encoding that nobody knows
        raise WorldFileError(f"{file}: {error}") from error
    names = [link.get("name", "") for link in robot.findall("link")]
    if robot.tag != "robot" or not names:
        raise WorldFileError(
            f"{file}: is no URDF; expected a <robot> with <link>s, found a <{robot.tag}> with {len(names)}"
        )
    _check_once(names, "links are named", file)
    joints = {_reference(joint, "child", names, file): joint for joint in robot.findall("joint")}
    _check_once(
        [_reference(joint, "child", names, file) for joint in robot.findall("joint")], "joints move", file
    )
    meanings = _semantics(folder / SEMANTICS)
    links = []
    for name, element in zip(names, robot.findall("link"), strict=True):
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
        parent, who = _reference(joint, "parent", names, file), f"{file}: joint {joint.get('name')!r}"
        pose, limits, axis = origin(joint, who, WorldFileError), _limits(joint, kind, who), _Z
        if kind != "fixed":  # exporters give the fixed ones an axis of zeros
            axis = _unit(triple(joint.find("axis"), "xyz", "1 0 0", who, WorldFileError), who)
        links.append(MobileLink(name, meanings.get(name, ""), parent, kind, pose, axis, limits, shapes))
    return links


_Z = np.array([0.0, 0.0, 1.0])


def _semantics(file: Path) -> dict[str, str]:
    """Meaning per link: the last word of its line."""
    if not file.is_file():
        return {}
    rows = [line.split() for line in text_of(file).splitlines() if line.strip()]
    return {row[0]: row[-1] for row in rows if len(row) >= 2}


def text_of(file: Path) -> str:
    """A text file's content.

    Raises:
        WorldFileError: It is not UTF-8.
    """
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise WorldFileError(
            f"{file}: is not UTF-8 ({error.reason} at byte {error.start}); save it as UTF-8"
        ) from error


def _check_once(names: list[str], what: str, file: Path) -> None:
    for name in names:
        if names.count(name) > 1:
            raise WorldFileError(f"{file}: {names.count(name)} {what} {name!r}; a URDF has one")


def _reference(joint: ET.Element, tag: str, links: list[str], file: Path) -> str:
    found = joint.find(tag)
    name = None if found is None else found.get("link")
    if not name:
        raise WorldFileError(f"{file}: joint {joint.get('name')!r} names no {tag} link")
    if name not in links:
        raise WorldFileError(
            f"{file}: joint {joint.get('name')!r} names the {tag} {name!r}, and no link is called that"
        )
    return name


def _unit(axis: np.ndarray, who: str) -> np.ndarray:
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise WorldFileError(f"{who}: its axis has no direction; give one that is not 0 0 0")
    return axis / length


def _limits(joint: ET.Element, kind: str, who: str) -> tuple[float, float]:
    """Least and largest value; URDF's own 0 where one of the two is not given."""
    tag = joint.find("limit")
    if kind == "fixed":
        return 0.0, 0.0
    if joint.get("type") == "continuous" or tag is None or not {"lower", "upper"} & tag.attrib.keys():
        return UNLIMITED[kind]
    try:
        low, high = float(tag.get("lower", "0")), float(tag.get("upper", "0"))
    except ValueError as error:
        raise WorldFileError(f"{who}: its limit is no number ({error})") from error
    if not -np.inf < low <= high < np.inf:
        raise WorldFileError(
            f"{who}: its limits go from {low:g} to {high:g}; lower must not be above upper, both finite"
        )
    if kind == "revolute" and high - low > WIDEST_TURN_RAD:
        raise WorldFileError(
            f"{who}: its limits go from {low:g} to {high:g}, that is {(high - low) / (2 * np.pi):.1f} times around; a "
            "URDF counts radians: are these degrees?"
        )
    return low, high


def _read_attributes(folder: Path) -> list[MobileLink]:
    try:
        tree = json.loads(text_of(folder / ATTRIBUTES))
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
        # A part that turns and slides is taken for one that turns.
        kinds = {"R": "revolute", "RT": "revolute", "T": "prismatic", "none": "fixed"}
        name, kind = str(node["dof_name"]), kinds[node.get("motion_type") or "none"]
        p = np.zeros(3) if kind == "fixed" else np.array(node["center"], dtype=float)
        axis = _Z if kind == "fixed" else np.array(node["direction"], dtype=float)
    except (KeyError, TypeError, ValueError) as error:
        raise WorldFileError(f"{folder / ATTRIBUTES}: a part lacks or misstates {error}") from error
    who = f"{folder / ATTRIBUTES}: part {name!r}"
    if p.shape != (3,) or axis.shape != (3,) or not np.isfinite([p, axis]).all():
        raise WorldFileError(
            f"{who}: center {p.tolist()}, direction {axis.tolist()}; each must be three finite numbers"
        )
    mesh, offset = np.eye(4), np.eye(4)
    mesh[:3, 3], offset[:3, 3] = -p, p - p_parent
    axis = _unit(axis, who)
    limits = UNLIMITED[kind] if kind != "fixed" else (0.0, 0.0)
    file = folder / PARTS / f"{'none_motion' if parent is None else name}.obj"
    links.append(MobileLink(name, name, parent, kind, offset, axis, limits, (MeshPlace(file, mesh),)))
    children = node.get("children") or []
    if not isinstance(children, list):
        raise WorldFileError(f"{who}: its children are {children!r}; they must be a list of parts")
    for child in children:
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
