"""What a body of meshes weighs: mass and inertia of the solids within them, instead of their convex hulls'."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from s2r_sim.errors import WorldFileError
from s2r_sim.objects.watertight import closed, hulled
from s2r_sim.objects.wavefront import triangles_of, vertices_of


def weigh(scene: mujoco.MjSpec, body: mujoco.MjsBody) -> tuple[str, ...]:
    """Give a body the mass and inertia of its shapes, each a closed solid of MuJoCo's usual density.

    Args:
        scene: With the meshes of the body, by their file or as vertices and faces.
        body: Without one that is told; its shapes are geoms of it.

    Returns:
        The meshes that bound no solid and weigh as their convex hull.

    Raises:
        WorldFileError: The body weighs nothing.
    """
    scale = mujoco.MjSpec()
    weighed = scale.worldbody.add_body(name="weighed")
    weighed.add_freejoint()
    hulls = []
    for geom in body.geoms:
        same = {"pos": geom.pos, "quat": geom.quat, "density": geom.density}
        if geom.type != mujoco.mjtGeom.mjGEOM_MESH:
            weighed.add_geom(type=geom.type, size=geom.size, **same)
            continue
        points, triangles = _surface(scene.mesh(geom.meshname))
        solid = closed(points, triangles)
        if solid is None:
            hulls.append(geom.meshname)
            solid = hulled(points)
        mesh = scale.add_mesh(name=geom.meshname, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT)
        mesh.uservert, mesh.userface = solid[0].ravel(), solid[1].ravel()
        weighed.add_geom(type=geom.type, meshname=geom.meshname, **same)
    try:
        model = scale.compile()
    except ValueError as error:
        reason = "; ".join(str(error).splitlines()).removeprefix("Error: ")
        raise WorldFileError(f"{scene.modelname}: what moves cannot be weighed: {reason}") from error
    found = model.body("weighed")
    body.mass, body.ipos, body.iquat = float(found.mass[0]), found.ipos, found.iquat
    body.inertia, body.explicitinertial = found.inertia, True
    return tuple(hulls)


def _surface(mesh: mujoco.MjsMesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m], (n, 3), and triangles (m, 3)."""
    if not mesh.file:
        return np.array(mesh.uservert).reshape(-1, 3), np.array(mesh.userface).reshape(-1, 3)
    file = Path(mesh.file)
    points = vertices_of(file)
    return points * mesh.scale, triangles_of(file, len(points))
