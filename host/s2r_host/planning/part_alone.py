"""The part by itself, in the fine model with an arm that touches nothing and everything else standing still."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.planning.scene import GeomKind, Scene
from s2r_host.planning.scene_spec import OBJECT_PREFIX
from s2r_host.planning.task import PlanRequest

_FROZEN = 1e6  # armature and damping of what shall not move


def is_coupled(scene: Scene) -> bool:
    """Whether other things may move along with the joint: they would be in other places than one can tell."""
    return bool(scene.fine.eq_active0.any() or scene.fine.tendon_limited.any())


def alone_model(scene: Scene) -> mujoco.MjModel:
    """The fine model in which nothing but the task's joint moves, and nothing that could is in its way."""
    model = scene.without_robot()
    others = np.arange(model.nv) != scene.s_dof
    others[: scene.dof] = False
    model.dof_armature[others] = model.dof_damping[others] = _FROZEN
    for geom in range(model.ngeom):
        body = model.geom_bodyid[geom]
        if scene.geom_kind[geom] == GeomKind.WORLD and model.body_weldid[body] != 0:
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
    return model


def alone_at(model: mujoco.MjModel, request: PlanRequest, scene: Scene, s: float) -> mujoco.MjData:
    """The state of :func:`alone_model` in which everything is at rest as at the start, the part at joint value s."""
    data = mujoco.MjData(model)
    if request.others is not None:
        data.qpos[scene.dof :] = request.others
    data.qpos[: scene.dof] = data.ctrl[: scene.dof] = np.asarray(request.q_initial, dtype=float)
    data.qpos[scene.s_qpos] = s
    mujoco.mj_forward(model, data)
    return data


def overlap(model: mujoco.MjModel, data: mujoco.MjData, scene: Scene) -> str | None:
    """What of the scene the part overlaps with most, for the middle of a sentence, or None."""
    kinds = scene.geom_kind[data.contact.geom].reshape(-1, 2)
    own = np.flatnonzero(((kinds == GeomKind.PART).sum(axis=1) == 1) & (data.contact.dist < 0.0))
    if not len(own):
        return None
    deepest = data.contact[int(own[data.contact.dist[own].argmin()])]
    one, other = (_name(model, int(geom)) for geom in deepest.geom)
    return f"overlaps by {-1e3 * deepest.dist:.1f} mm ({one} with {other})"


def _name(model: mujoco.MjModel, geom: int) -> str:
    """A geom as its file calls it, or its kind and body."""
    body = int(model.geom_bodyid[geom])
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    own, of = (thing.name.removeprefix(OBJECT_PREFIX) for thing in (model.geom(geom), model.body(body)))
    return own or f"a {kind} of body {of or body!r}"
