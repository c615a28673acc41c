"""Reading the URDF of an arm: links with inertia and geometry, joints with limits, each in its own frame."""

from __future__ import annotations

import xml.etree.ElementTree as ET
import xml.parsers.expat as expat
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from s2r_protocol.arms import ArmDescriptionError
from s2r_protocol.arms.urdf_tags import origin, triple


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²], axes as the link's."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True, eq=False)
class Geometry:
    """One solid of a link.

    Attributes:
        kind: "box", "cylinder", "sphere" or "mesh".
        size: Half extents of a box, radius and half length of a cylinder, radius of a sphere, a mesh's scale.
        X_link_solid: Pose of its frame in the link's, (4, 4).
        file: The mesh as the URDF names it.
        name: What the URDF calls the solid; often nothing.
    """

    kind: str
    size: np.ndarray
    X_link_solid: np.ndarray
    file: str = ""
    name: str = ""


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A link; ``inertial`` is None where the URDF has no mass, and without moments where it has no ``<inertia>``."""

    name: str
    inertial: Inertial | None
    solids: tuple[Geometry, ...]


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint; limits are None where the URDF does not say them, ``axis`` (3,) has length 1.

    ``soft`` are the position limits that its controller keeps, ``mimic`` the leader, the factor and the shift.
    """

    name: str
    kind: str
    parent: str
    child: str
    X_parent_joint: np.ndarray
    axis: np.ndarray
    lower: float | None
    upper: float | None
    velocity: float | None
    effort: float | None
    mimic: tuple[str, float, float] | None
    soft: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class UrdfTree:
    """All links and joints of one URDF, by name; every joint also by the link it carries."""

    name: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]

    @property
    def root(self) -> str:
        """The link that nothing carries."""
        return next(iter(self.links.keys() - {j.child for j in self.joints.values()}))

    def way_to(self, link: str) -> list[UrdfJoint]:
        """The joints from the root to a link, in that order."""
        carrier = {j.child: j for j in self.joints.values()}
        way: list[UrdfJoint] = []
        while link in carrier:
            way.insert(0, carrier[link])
            link = carrier[link].parent
        return way

    def renamed(self, old: str, new: str) -> UrdfTree:
        """The same tree with another name for one link."""

        def here(link: str) -> str:
            return new if link == old else link

        links = {here(name): replace(link, name=here(name)) for name, link in self.links.items()}
        joints = {
            name: replace(joint, parent=here(joint.parent), child=here(joint.child))
            for name, joint in self.joints.items()
        }
        return UrdfTree(self.name, links, joints)

    def leader_of(self, joint: str) -> str | None:
        """The joint that a joint follows; None where it moves by itself, or where there is no such leader."""
        mimic = self.joints[joint].mimic
        return None if mimic is None or mimic[0] not in self.joints else mimic[0]

    def below(self, link: str) -> Iterator[str]:
        """A link and all that hangs off it."""
        yield link
        for joint in self.joints.values():
            if joint.parent == link:
                yield from self.below(joint.child)


def read_urdf(path: Path) -> UrdfTree:
    """Read a URDF.

    Raises:
        ArmDescriptionError: It cannot be read, or is no tree of links.
    """
    try:
        root = _parsed(path.read_bytes().lstrip())
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise ArmDescriptionError(f"{path} is no readable URDF: {error}") from error
    if root.tag != "robot":
        other = {"sdf": " (this is SDF)", "mujoco": " (this is MJCF)", "COLLADA": " (this is a mesh)"}
        raise ArmDescriptionError(
            f"{path} is no URDF: it begins with <{root.tag}>{other.get(root.tag, '')}, expected <robot>"
        )
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        raise ArmDescriptionError(f"{path} holds xacro; expand it first: xacro {path.name} > arm.urdf")
    links = {}
    for tag in root.findall("link"):
        name = _name(tag, str(path))
        if name in links:
            raise ArmDescriptionError(f"{path}: link {name!r} is there twice")
        links[name] = _link(tag, name, path)
    joints = {}
    for tag in root.findall("joint"):
        name = _name(tag, str(path))
        if name in joints:
            raise ArmDescriptionError(f"{path}: joint {name!r} is there twice")
        joints[name] = _joint(tag, name, path)
    tree = UrdfTree(root.get("name", ""), links, joints)
    _refuse_no_tree(tree, path)
    _refuse_followers_in_a_circle(tree, path)
    return tree


def _parsed(text: bytes) -> ET.Element:
    """The root of an XML text; names keep their prefix, also one that nothing declares, as in tags for a simulator."""
    parser, builder = expat.ParserCreate(), ET.TreeBuilder()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.Parse(text, True)
    return builder.close()


def _refuse_no_tree(tree: UrdfTree, path: Path) -> None:
    for joint in tree.joints.values():
        for link in (joint.parent, joint.child):
            if link not in tree.links:
                raise ArmDescriptionError(
                    f"{path}: joint {joint.name!r} names a link {link!r}, which is not there"
                )
    carried = [j.child for j in tree.joints.values()]
    roots = sorted(tree.links.keys() - set(carried))
    twice = sorted({name for name in carried if carried.count(name) > 1})
    if len(roots) != 1 or twice:
        what = f"link {twice[0]!r} hangs off several joints" if twice else f"{len(roots)} links hang off none"
        raise ArmDescriptionError(
            f"{path}: {what}; the links of a URDF form one tree ({', '.join(roots) or 'no root'})"
        )
    if len(list(tree.below(roots[0]))) != len(tree.links):
        raise ArmDescriptionError(f"{path}: some links hang in a circle; the links of a URDF form one tree")


def _refuse_followers_in_a_circle(tree: UrdfTree, path: Path) -> None:
    for name in tree.joints:
        followed, leader = [name], tree.leader_of(name)
        while leader is not None and leader not in followed:
            followed.append(leader)
            leader = tree.leader_of(leader)
        if leader is not None:
            raise ArmDescriptionError(
                f"{path}: joint {leader!r} follows itself by way of <mimic>: {', '.join(followed)}"
            )


def _name(tag: ET.Element, who: str) -> str:
    name = tag.get("name", "")
    if not name:
        raise ArmDescriptionError(f"{who}: a <{tag.tag}> has no name")
    return name


def _link(tag: ET.Element, name: str, path: Path) -> UrdfLink:
    who = f"{path}: link {name!r}"
    shown = tag.findall("collision") or tag.findall("visual")
    return UrdfLink(name, _inertial(tag.find("inertial"), who), tuple(_geometry(t, who) for t in shown))


def _inertial(tag: ET.Element | None, who: str) -> Inertial | None:
    if tag is None:
        return None
    mass_tag, inertia_tag = tag.find("mass"), tag.find("inertia")
    mass = 0.0 if mass_tag is None else _number(mass_tag, "value", who) or 0.0
    if mass <= 0.0:
        return None
    X = origin(tag, who, ArmDescriptionError)
    xx, yy, zz, xy, xz, yz = (
        0.0 if inertia_tag is None else _number(inertia_tag, key, who) or 0.0
        for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Inertial(mass, X[:3, 3], X[:3, :3] @ moments @ X[:3, :3].T)


def _geometry(tag: ET.Element, who: str) -> Geometry:
    holder, X, name = tag.find("geometry"), origin(tag, who, ArmDescriptionError), tag.get("name", "")
    shape = None if holder is None else next(iter(holder), None)
    if shape is None:
        raise ArmDescriptionError(f"{who}: a <{tag.tag}> has no geometry")
    if shape.tag == "mesh" and not shape.get("filename"):
        raise ArmDescriptionError(f"{who}: a <mesh> names no file")
    if shape.tag == "mesh":
        return Geometry(
            "mesh",
            triple(shape, "scale", "1 1 1", who, ArmDescriptionError),
            X,
            shape.get("filename", ""),
            name,
        )
    if shape.tag == "box":
        size = 0.5 * triple(shape, "size", "", who, ArmDescriptionError)
    elif shape.tag == "cylinder":
        size = np.array([_number(shape, "radius", who) or 0.0, 0.5 * (_number(shape, "length", who) or 0.0)])
    elif shape.tag == "sphere":
        size = np.array([_number(shape, "radius", who) or 0.0])
    else:
        raise ArmDescriptionError(f"{who} has a <{shape.tag}>; known are box, cylinder, sphere and mesh")
    if size.min() <= 0.0:
        raise ArmDescriptionError(f"{who}: its <{shape.tag}> must have sizes above 0")
    return Geometry(shape.tag, size, X, name=name)


def _joint(tag: ET.Element, name: str, path: Path) -> UrdfJoint:
    who = f"{path}: joint {name!r}"
    ends = {end: tag.find(end) for end in ("parent", "child")}
    parent, child = ("" if t is None else t.get("link", "") for t in ends.values())
    axis = triple(tag.find("axis"), "xyz", "1 0 0", who, ArmDescriptionError)
    kind, length = tag.get("type", ""), float(np.linalg.norm(axis))
    if kind not in ("fixed", "revolute", "continuous", "prismatic", "planar", "floating"):
        raise ArmDescriptionError(f"{who} is of type {kind!r}, which URDF does not know")
    if length == 0.0 and kind in ("fixed", "floating"):  # CAD exporters write it, and nothing turns about it
        axis, length = np.array([1.0, 0.0, 0.0]), 1.0
    if length == 0.0:
        raise ArmDescriptionError(f"{who}: axis 0 0 0 has no direction")
    limit, mimic, soft = tag.find("limit"), tag.find("mimic"), _soft(tag.find("safety_controller"), who)
    said = [
        None if limit is None else _number(limit, key, who)
        for key in ("lower", "upper", "velocity", "effort")
    ]
    follows = None
    if mimic is not None:
        factor, shift = _number(mimic, "multiplier", who), _number(mimic, "offset", who)
        follows = (mimic.get("joint", ""), 1.0 if factor is None else factor, shift or 0.0)
    return UrdfJoint(
        name,
        kind,
        parent,
        child,
        origin(tag, who, ArmDescriptionError),
        axis / length,
        *said,
        mimic=follows,
        soft=soft,
    )


def _soft(tag: ET.Element | None, who: str) -> tuple[float, float] | None:
    """The range that a joint's controller keeps; without both ends it keeps none."""
    if tag is None:
        return None
    low, high = (_number(tag, f"soft_{end}_limit", who) for end in ("lower", "upper"))
    return None if low is None or high is None else (low, high)


def _number(tag: ET.Element, attribute: str, who: str) -> float | None:
    text = tag.get(attribute)
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ArmDescriptionError(f"{who}: {attribute} {text!r} of its <{tag.tag}> is no finite number")
    return value


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation (3, 3) about a unit axis (3,) by an angle [rad]."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
