"""Objects of convex meshes instead of boxes: every box cut into some, or each body as CoACD decomposes it."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from s2r_host.model.decompose import Fineness, decompose_surface

# CoACD wraps the boxes in voxels first; with fewer of them walls of a centimetre become twice as thick.
_FINE = Fineness(threshold=0.03, preprocess_resolution=80, mcts_iterations=60, max_convex_hull=-1)
_CPU_LIMIT_S = 600.0


def write_in_pieces(source: Path, pieces: int) -> Path:
    """Write the object beside ``source`` with each of its boxes cut into so many convex meshes; returns the file."""
    spec = mujoco.MjSpec.from_file(str(source))
    for geom in _boxes(spec.geoms):
        half, name, body = np.array(geom.size), geom.name, geom.parent
        axis = int(half.argmax())
        edges = np.linspace(-half[axis], half[axis], pieces + 1)
        for k, (start, end) in enumerate(itertools.pairwise(edges)):
            sides = [(-size, size) for size in half]
            sides[axis] = (start, end)
            corners = np.array(list(itertools.product(*sides)))
            mesh = spec.add_mesh(name=f"{name}_mesh_{k}", uservert=corners.ravel().tolist())
            body.add_geom(
                name=f"{name}_{k}",
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=mesh.name,
                pos=geom.pos,
                quat=geom.quat,
            )
        spec.delete(geom)
    return _written(spec, source.with_name(f"{source.stem}_in_{pieces}.xml"))


def write_decomposed(source: Path) -> Path:
    """Write the object beside ``source`` with the boxes of each body as CoACD decomposes them; returns the file.

    Raises:
        RuntimeError: CoACD gave no pieces.
    """
    spec = mujoco.MjSpec.from_file(str(source))
    for body in spec.bodies:
        boxes = _boxes(body.geoms)
        if not boxes:
            continue
        surface = trimesh.util.concatenate([_surface(geom) for geom in boxes])
        for k, vertices in enumerate(_decomposed(surface.vertices.tobytes(), surface.faces.tobytes())):
            name = f"{body.name}_piece_{k}"
            spec.add_mesh(name=name, uservert=vertices.ravel().tolist())
            body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
        for geom in boxes:
            spec.delete(geom)
    return _written(spec, source.with_name(f"{source.stem}_coacd.xml"))


@functools.cache
def _decomposed(vertices: bytes, faces: bytes) -> list[np.ndarray]:
    """Hulls of a surface given by the bytes of its arrays, which can be a key: the tasks on one object share them."""
    corners, triangles = (
        np.frombuffer(vertices).reshape(-1, 3),
        np.frombuffer(faces, dtype=np.int64).reshape(-1, 3),
    )
    hulls, failure = decompose_surface(corners, triangles, _CPU_LIMIT_S, _FINE)
    if failure is not None:
        raise RuntimeError(f"the convex decomposition {failure}")
    return hulls


def _boxes(geoms: Iterable[mujoco.MjsGeom]) -> list[mujoco.MjsGeom]:
    return [geom for geom in geoms if geom.type == mujoco.mjtGeom.mjGEOM_BOX]


def _surface(box: mujoco.MjsGeom) -> trimesh.Trimesh:
    """Of a box, in its body's frame [m]."""
    X_body_box = trimesh.transformations.quaternion_matrix(np.array(box.quat))
    X_body_box[:3, 3] = box.pos
    return trimesh.creation.box(extents=2.0 * np.array(box.size), transform=X_body_box)


def _written(spec: mujoco.MjSpec, path: Path) -> Path:
    spec.compile()
    path.write_text(spec.to_xml())
    return path
