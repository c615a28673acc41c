"""Objects as a mesh decomposition gives them: every box replaced by convex meshes that fill it."""

from __future__ import annotations

import itertools
from pathlib import Path

import mujoco
import numpy as np


def write_in_pieces(source: Path, pieces: int) -> Path:
    """Write the object beside ``source`` with each of its boxes cut into so many convex meshes; returns the file."""
    spec = mujoco.MjSpec.from_file(str(source))
    for geom in list(spec.geoms):
        if geom.type != mujoco.mjtGeom.mjGEOM_BOX:
            continue
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
    spec.compile()
    path = source.with_name(f"{source.stem}_in_{pieces}.xml")
    path.write_text(spec.to_xml())
    return path
