"""What a link of an object's URDF consists of: mesh files, boxes, cylinders and spheres, and where they sit."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from s2r_protocol.arms.urdf_tags import origin, triple
from s2r_sim.errors import WorldFileError

SOLIDS = ("box", "cylinder", "sphere")


@dataclass(frozen=True, eq=False)
class MeshPlace:
    """A mesh file and where its frame sits in its link's frame (4, 4), scaled by so much per axis, shape (3,)."""

    file: Path
    X_link_mesh: np.ndarray
    scale: np.ndarray = field(default_factory=lambda: np.ones(3))


@dataclass(frozen=True, eq=False)
class SolidPlace:
    """A primitive solid.

    Attributes:
        kind: One of `SOLIDS`.
        size: Half of what it measures [the file's units], as MuJoCo has it: a box along x, y, z; a cylinder's radius
            and half its length along z; a sphere's radius.
        X_link_solid: Pose of its middle in the link's frame, shape (4, 4).
    """

    kind: str
    size: tuple[float, ...]
    X_link_solid: np.ndarray

    def reach(self, R: np.ndarray) -> np.ndarray:
        """How far it goes from its middle along the axes of a frame in which it is turned by ``R``, shape (3,)."""
        if self.kind == "box":
            return np.abs(R) @ np.array(self.size)
        if self.kind == "sphere":
            return np.full(3, self.size[0])
        along = np.abs(R[:, 2])
        return self.size[0] * np.sqrt(np.clip(1.0 - along**2, 0.0, 1.0)) + self.size[1] * along


Shape = MeshPlace | SolidPlace


def shapes_of(link: ET.Element, folder: Path) -> tuple[Shape, ...]:
    """The shapes of a URDF link: what is seen of it or, where it has nothing to be seen, what it collides with.

    Raises:
        WorldFileError: A geometry that cannot be read; the text names its link.
    """
    found = link.findall("visual") or link.findall("collision")
    return tuple(_shape(element, link.get("name", ""), folder) for element in found)


def _shape(element: ET.Element, link: str, folder: Path) -> Shape:
    who = f"{folder}: a {element.tag} of link {link!r}"
    geometry, X = element.find("geometry"), origin(element, who, WorldFileError)
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        raise WorldFileError(f"{who} has no geometry")
    if shape.tag == "mesh":
        scale = triple(shape, "scale", "1 1 1", who, WorldFileError)
        if not scale.all():
            raise WorldFileError(
                f"{who}: scale {shape.get('scale')!r} makes its mesh flat; give numbers other than 0"
            )
        return MeshPlace(folder / shape.get("filename", ""), X, scale)
    try:
        if shape.tag == "box":
            (x, y, z) = (0.5 * triple(shape, "size", "", who, WorldFileError)).tolist()
            size: tuple[float, ...] = (x, y, z)
        elif shape.tag == "cylinder":
            size = (float(shape.attrib["radius"]), 0.5 * float(shape.attrib["length"]))
        elif shape.tag == "sphere":
            size = (float(shape.attrib["radius"]),)
        else:
            raise WorldFileError(
                f"{folder}: link {link!r} has a {shape.tag!r}; known are mesh, {', '.join(SOLIDS)}"
            )
    except (KeyError, ValueError) as error:
        if isinstance(error, WorldFileError):
            raise
        raise WorldFileError(
            f"{folder}: the {shape.tag} of link {link!r} lacks or misstates its size ({error})"
        ) from error
    if min(size) <= 0.0 or not np.isfinite(size).all():
        raise WorldFileError(f"{folder}: the {shape.tag} of link {link!r} must have sizes above 0")
    return SolidPlace(shape.tag, size, X)
