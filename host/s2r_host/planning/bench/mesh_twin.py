"""Objects of convex meshes instead of boxes: every box cut into some, or each body as CoACD decomposes it."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.model.decompose import Fineness, decompose_surface

# CoACD wraps the boxes in voxels first; with fewer of them walls of a centimetre become twice as thick.
_FINE = Fineness(threshold=0.03, preprocess_resolution=80, mcts_iterations=60, max_convex_hull=-1)
_CPU_LIMIT_S = 600.0
# Corners of a unit cube in the order of itertools.product, and its triangles, outward.
_UNIT = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_FACES = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
     (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
)  # fmt: skip


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
        for k, vertices in enumerate(
            _decomposed(np.concatenate([_corners(geom) for geom in boxes]).tobytes())
        ):
            name = f"{body.name}_piece_{k}"
            spec.add_mesh(name=name, uservert=vertices.ravel().tolist())
            body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
        for geom in boxes:
            spec.delete(geom)
    return _written(spec, source.with_name(f"{source.stem}_coacd.xml"))


@functools.cache
def _decomposed(corners: bytes) -> list[np.ndarray]:
    """Hulls of boxes given by the bytes of their corners (8 n, 3): the tasks on one object share them."""
    vertices = np.frombuffer(corners).reshape(-1, 3)
    faces = np.concatenate([_FACES + start for start in range(0, len(vertices), 8)])
    hulls, failure = decompose_surface(vertices, faces, _CPU_LIMIT_S, _FINE)
    if failure is not None:
        raise RuntimeError(f"the convex decomposition {failure}")
    return hulls


def _boxes(geoms: Iterable[mujoco.MjsGeom]) -> list[mujoco.MjsGeom]:
    return [geom for geom in geoms if geom.type == mujoco.mjtGeom.mjGEOM_BOX]


def _corners(box: mujoco.MjsGeom) -> np.ndarray:
    """Of a box, in its body's frame [m], (8, 3)."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, np.array(box.quat))
    return np.array(box.pos) + (_UNIT * np.array(box.size)) @ R.reshape(3, 3).T


def _written(spec: mujoco.MjSpec, path: Path) -> Path:
    spec.compile()
    path.write_text(spec.to_xml())
    return path
