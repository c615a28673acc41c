"""The arm for pictures: one triangle mesh per moving body, and where the bodies are at given joint values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
import trimesh

from s2r_protocol.arms import ArmDescription


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """A body's surface in its own frame: ``vertices`` (n, 3) [m], ``faces`` (m, 3)."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray

    def inflated(self, by_m: float) -> np.ndarray:
        """Vertices moved outwards along their normals [m], shape (n, 3)."""
        if by_m == 0.0 or not len(self.vertices):
            return self.vertices
        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        return (self.vertices + by_m * mesh.vertex_normals).astype(np.float32)


class ArmShapes:
    """Meshes and forward kinematics of one arm. Not thread-safe: it owns one Pinocchio workspace."""

    def __init__(self, arm: ArmDescription) -> None:
        self._model = pin.buildModelFromXML(arm.urdf)
        self._data = self._model.createData()
        self._geometry = pin.buildGeomFromUrdfString(self._model, arm.urdf, pin.GeometryType.COLLISION)
        self._tool = self._model.getFrameId(arm.tool_frame, pin.FrameType.BODY)
        self._arm = arm

    @cached_property
    def bodies(self) -> tuple[BodyMesh, ...]:
        """Base first, then the body behind each joint; the tool belongs to the last one."""
        parts: dict[int, list[trimesh.Trimesh]] = {i: [] for i in range(self._model.njoints)}
        for shape in self._geometry.geometryObjects:
            mesh = _mesh_of(shape.geometry)
            mesh.apply_transform(shape.placement.homogeneous)
            parts[shape.parentJoint].append(mesh)
        names = ("base", *self._arm.joint_names)
        whole = [trimesh.util.concatenate(parts[i]) if parts[i] else trimesh.Trimesh() for i in parts]
        return tuple(
            BodyMesh(name, np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
            for name, mesh in zip(names, whole, strict=True)
        )

    def poses(self, q: np.ndarray) -> np.ndarray:
        """X_base_body of every body at ``q`` [rad], shape (dof + 1, 4, 4)."""
        pin.forwardKinematics(self._model, self._data, np.asarray(q, float))
        return np.array([self._data.oMi[i].homogeneous for i in range(self._model.njoints)])

    def tool_path(self, q: np.ndarray) -> np.ndarray:
        """Where the tool tip is at each row of ``q`` (n, dof) [rad]: (n, 3) [m]."""
        points = []
        for row in np.asarray(q, float):
            pin.framesForwardKinematics(self._model, self._data, row)
            points.append(self._data.oMf[self._tool].translation.copy())
        return np.array(points).reshape(-1, 3)


def quat_wxyz(R: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) as a unit quaternion (w, x, y, z)."""
    x, y, z, w = pin.Quaternion(R).coeffs()
    return np.array([w, x, y, z])


def _mesh_of(shape: object) -> trimesh.Trimesh:
    kind = type(shape).__name__
    if kind == "Box":
        return trimesh.creation.box(extents=2.0 * np.asarray(shape.halfSide).ravel())  # type: ignore[attr-defined]
    if kind == "Sphere":
        return trimesh.creation.icosphere(subdivisions=2, radius=shape.radius)  # type: ignore[attr-defined]
    radius, height = float(shape.radius), 2.0 * float(shape.halfLength)  # type: ignore[attr-defined]
    if kind == "Capsule":
        mesh = trimesh.creation.capsule(height=height, radius=radius, count=[20, 20])
        mesh.apply_translation([0, 0, -mesh.bounds.mean(axis=0)[2]])
        return mesh
    if kind == "Cylinder":
        return trimesh.creation.cylinder(radius=radius, height=height, sections=28)
    raise TypeError(f"no mesh for a {kind}; arms are described by boxes, spheres, capsules and cylinders")
