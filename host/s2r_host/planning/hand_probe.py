"""The hand as a free body among the object's geoms: where it fits and what it would touch, without physics."""

from __future__ import annotations

import copy
import logging

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from s2r_host.planning.contact_count import ContactCount
from s2r_host.planning.scene import GeomKind, Scene

logger = logging.getLogger(__name__)

_COPY = "geom_"  # copies are called by the number of their original: names may be missing


class HandProbe:
    """The hand as a free body among the object's geoms; says where it would touch what."""

    def __init__(self, scene: Scene, data: mujoco.MjData, threads: int) -> None:
        spec = mujoco.MjSpec()
        model = scene.fine
        for geom in range(model.ngeom):
            if scene.geom_kind[geom] <= GeomKind.PART and scene.solid[geom]:
                _copy_geom(spec, spec.worldbody, model, geom, data.geom_xpos[geom], data.geom_xmat[geom])
        hand = spec.worldbody.add_body(name="hand")
        hand.add_freejoint()
        hand.mass, hand.inertia, hand.explicitinertial = 1.0, [0.01, 0.01, 0.01], True
        p_tool, R_tool = data.site_xpos[scene.tool_site], data.site_xmat[scene.tool_site].reshape(3, 3)
        weld = model.body_weldid[model.site_bodyid[scene.tool_site]]
        for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] == weld):
            R_geom = R_tool.T @ data.geom_xmat[geom].reshape(3, 3)
            p_geom = R_tool.T @ (data.geom_xpos[geom] - p_tool)
            _copy_geom(spec, hand, model, int(geom), p_geom, R_geom.ravel())
        everything = spec.compile()
        fingers = copy.copy(everything)
        source = np.array([int(everything.geom(g).name.removeprefix(_COPY)) for g in range(everything.ngeom)])
        self._finger = scene.geom_kind[source] == GeomKind.FINGER
        is_part = scene.geom_kind[source] == GeomKind.PART
        in_hand = everything.geom_bodyid == everything.body("hand").id
        fingers.geom_contype[in_hand & ~self._finger] = 0
        fingers.geom_conaffinity[in_hand & ~self._finger] = 0
        fingers.geom_contype[~in_hand & ~is_part] = 0
        fingers.geom_conaffinity[~in_hand & ~is_part] = 0
        self._all, self._fingers = (ContactCount(model, threads) for model in (everything, fingers))

    def contacts(self, p_world: np.ndarray, quat_wxyz: np.ndarray) -> np.ndarray:
        """Number of contacts of the hand with anything, (n,), at n tool poses."""
        return self._all.at(np.concatenate([p_world, quat_wxyz], axis=1))

    def finger_contacts(self, p_world: np.ndarray, quat_wxyz: np.ndarray) -> np.ndarray:
        """Number of contacts between fingers and part alone, (n,), at n tool poses."""
        return self._fingers.at(np.concatenate([p_world, quat_wxyz], axis=1))


def quat_of(R: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) to quaternion wxyz, (4,)."""
    quat_wxyz = np.empty(4)
    mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(R).ravel())
    return quat_wxyz


def quats_of(R: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) to quaternions wxyz, (n, 4)."""
    if not len(R):
        return np.zeros((0, 4))
    return Rotation.from_matrix(R).as_quat(scalar_first=True)


def _copy_geom(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, model: mujoco.MjModel, geom: int, p: np.ndarray, R: np.ndarray
) -> None:
    """A geom of a compiled model as a geom of another body, at a pose in that body's frame."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind in (mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF):
        logger.warning("geom %d is a %s: no places are looked for near it", geom, kind.name)
        return
    copy = body.add_geom(
        name=f"{_COPY}{geom}", type=kind, size=model.geom_size[geom], pos=p, quat=quat_of(R.reshape(3, 3))
    )
    in_hand = body.name == "hand"
    copy.contype, copy.conaffinity = (1, 2) if in_hand else (2, 1)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        mesh_name = f"mesh_{geom}"
        spec.add_mesh(name=mesh_name, uservert=model.mesh_vert[start : start + count].ravel().tolist())
        copy.meshname = mesh_name
