"""The built object model (MJCF) as obstacles at a given joint value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import coal
import mujoco
import numpy as np

from s2r_host.motion.obstacles import Obstacle, convex_obstacle
from s2r_host.object_names import JOINT, PART_PREFIX


def object_obstacles(mjcf_path: Path, s: float, joint: str = JOINT) -> list[Obstacle]:
    """Every geom of an object file that something can touch, at joint value ``s`` [m or rad].

    Boxes, spheres, cylinders and capsules stay primitives; meshes become their convex hull, which they are
    by construction. Planes are left out (the table is its own obstacle).
    """
    model = mujoco.MjModel.from_xml_path(str(mjcf_path))
    return _obstacles(model, mujoco.MjData(model), s, joint)


def part_obstacles(mjcf_path: Path) -> Callable[[float], list[Obstacle]]:
    """The geoms of an object file's part as obstacles, by joint value [m or rad]; the file is read once."""
    model = mujoco.MjModel.from_xml_path(str(mjcf_path))
    data = mujoco.MjData(model)
    return lambda s: [o for o in _obstacles(model, data, s, JOINT) if o.name.startswith(PART_PREFIX)]


def _obstacles(model: mujoco.MjModel, data: mujoco.MjData, s: float, joint: str) -> list[Obstacle]:
    data.qpos[model.jnt_qposadr[model.joint(joint).id]] = s
    mujoco.mj_kinematics(model, data)
    found = []
    for i in np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist():
        name = model.geom(i).name or f"geom{i}"
        X = np.eye(4)
        X[:3, :3] = data.geom_xmat[i].reshape(3, 3)
        X[:3, 3] = data.geom_xpos[i]
        obstacle = _shape(model, i, name, X)
        if obstacle is not None:
            found.append(obstacle)
    return found


def _shape(model: mujoco.MjModel, i: int, name: str, X: np.ndarray) -> Obstacle | None:
    size = model.geom_size[i]
    kind = mujoco.mjtGeom(int(model.geom_type[i]))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return Obstacle(name, coal.Box(*(2.0 * size)), X)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return Obstacle(name, coal.Sphere(size[0]), X)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return Obstacle(name, coal.Cylinder(size[0], 2.0 * size[1]), X)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return Obstacle(name, coal.Capsule(size[0], 2.0 * size[1]), X)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[i]
        start = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
        return convex_obstacle(name, vertices, X)
    return None
