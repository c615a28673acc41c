"""Solids of a URDF as the shapes of an ``arm.yaml``: what these cannot say is enclosed, never cut."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.arm_import.enclosing import box, rod
from s2r_host.arm_import.pieces import enclosed
from s2r_host.arm_import.urdf_tree import Geometry
from s2r_protocol.arms import ArmDescriptionError
from s2r_protocol.arms.source import SHORTEST_ROD_M

_ALIGNED = 1e-3  # a box turned by less [rad] keeps its size


def shapes_of(
    solid: Geometry, X_body_link: np.ndarray, urdf: Path, packages: Sequence[Path]
) -> list[dict[str, Any]]:
    """One solid as shapes in the frame of a body, without their names: several where a mesh is cut.

    Args:
        solid: As the URDF has it.
        X_body_link: Pose of its link in the body, (4, 4).
        urdf: The file that names meshes.
        packages: Folders that hold what ``package://`` names; those above the URDF are looked through anyway.

    Raises:
        ArmDescriptionError: A mesh is missing or cannot be read.
    """
    X = X_body_link @ solid.X_link_solid
    R, p = X[:3, :3], X[:3, 3]
    if solid.kind == "sphere":
        return [rod("capsule", p, R[:, 2], 0.0, float(solid.size[0]))]
    if solid.kind == "cylinder":
        radius, half = (float(v) for v in solid.size)
        return [rod("cylinder", p, R[:, 2], half, radius)]
    if solid.kind == "box":
        half = solid.size
        reach = np.abs(R) @ half
        turned = np.abs(R).max(axis=0).min() < np.cos(_ALIGNED)
        return [box(p, reach if turned else _permuted(R, half))]
    points, faces = _surface(solid, urdf, packages)
    return enclosed((points @ R.T + p, faces))


def with_round_ends(shapes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Shapes of an arm; a cylinder with a ball of its radius at both ends, as URDF says a capsule, is one again."""
    balls = [
        s for s in shapes if s["type"] == "capsule" and np.linalg.norm(_middle(s) - s["a"]) < SHORTEST_ROD_M
    ]
    swallowed, found = [], []
    for shape in shapes:
        ends = [
            next((b for b in balls if b not in swallowed and _is_end(b, shape, end)), None)
            for end in ("a", "b")
        ]
        if shape["type"] == "cylinder" and None not in ends:
            swallowed += ends
            shape = {**shape, "type": "capsule", "name": shape["name"].removesuffix("_rod")}
        found.append(shape)
    return [shape for shape in found if shape not in swallowed]


def _middle(rod: dict[str, Any]) -> np.ndarray:
    return 0.5 * (np.array(rod["a"]) + np.array(rod["b"]))


def _is_end(ball: dict[str, Any], rod: dict[str, Any], end: str) -> bool:
    """Whether a ball rounds this end of a cylinder off."""
    return (
        rod["type"] == "cylinder"
        and ball["link"] == rod["link"]
        and abs(ball["radius"] - rod["radius"]) < 1e-6
        and bool(np.linalg.norm(_middle(ball) - rod[end]) < 1e-6)
    )


def _permuted(R: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Half extents of a box whose axes are those of the frame, in another order."""
    return np.round(np.abs(R)) @ half


def _surface(solid: Geometry, urdf: Path, packages: Sequence[Path]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [m] and faces (m, 3) of a mesh."""
    import trimesh
    from trimesh.units import unit_conversion

    file = _find(solid.file, urdf, packages)
    try:
        scene = trimesh.load_scene(file)
        mesh = scene.to_mesh()
        unit_m = unit_conversion(scene.units, "meters") if scene.units else 1.0  # Collada says its own
        points, faces = unit_m * np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=int)
    except Exception as error:  # a reader of foreign files may raise anything
        raise ArmDescriptionError(
            f"mesh {file} cannot be read ({error}); give it as STL or OBJ, or a box or cylinder instead"
        ) from error
    if points.ndim != 2 or len(points) == 0 or not np.isfinite(points).all():
        raise ArmDescriptionError(f"mesh {file} holds no points; give it as STL or OBJ")
    return points * solid.size, faces


def _find(name: str, urdf: Path, packages: Sequence[Path]) -> Path:
    """The file of a mesh: beside the URDF, absolute, or in a package that lies around it."""
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        above = list(urdf.resolve().parents)
        tried = [folder / package / rest for folder in (*packages, *above)]
        tried += [folder / rest for folder in (*packages, *above) if folder.name == package]
        fix = f"give --packages the folder that holds the package {package!r}"
    else:
        tried = [urdf.parent / name.removeprefix("file://")]
        fix = "it is named from the URDF's folder"
    for file in tried:
        if file.is_file():
            return file
    raise ArmDescriptionError(f"mesh {name} is not there; {fix}")
