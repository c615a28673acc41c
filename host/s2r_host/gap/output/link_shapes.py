"""What is drawn of a model: its visible shapes, and rods and blocks for bodies that have none."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.gap.motion.model import RigidModel

THIN = 0.03  # radius of a rod over the size of the machine
TRAVELS = 0.6  # length of a block on a slide, over the travel that is drawn
LEAST_M = 1e-4
HIDDEN_GROUPS = 3  # shapes in this group and above are for contacts, by convention
STEEL, RAIL = (0.45, 0.55, 0.68, 1.0), (0.75, 0.77, 0.8, 1.0)


def visible_model(rigid: RigidModel, recorded: np.ndarray) -> mujoco.MjModel:
    """A copy whose geom group 0 holds what is drawn.

    Args:
        rigid: The user's model.
        recorded: Poses [rad or m], shape (moment, joint): how far slides without a shape travel.
    """
    m = rigid.model
    visible = m.geom_rgba[:, 3] > 0.0
    front = visible & (m.geom_group < HIDDEN_GROUPS)
    shown = {int(b) for b in m.geom_bodyid[front if front.any() else visible]}
    spec = rigid.spec.copy()
    size = _size(rigid, recorded)
    for j, joint in enumerate(rigid.joints):
        body = int(m.jnt_bodyid[j])
        if any(b in shown for b in _carried(rigid, body)):
            continue
        shown.add(body)
        element = spec.body(rigid.body_name(body))
        if rigid.unit(joint) == "m":
            travel = max(float(np.ptp(recorded[:, j])), 0.3 * size)
            _block(spec, element, m, j, travel)
        else:
            _rods(element, m, body, np.array(m.jnt_axis[j]), size)
    compiled = spec.compile()
    if front.any():
        own = (compiled.geom_group < HIDDEN_GROUPS) & (compiled.geom_rgba[:, 3] > 0.0)
    else:
        own = compiled.geom_rgba[:, 3] > 0.0
    compiled.geom_group[:] = np.where(own, 0, 5)
    return compiled


def _carried(rigid: RigidModel, body: int) -> list[int]:
    """A body and those fixed to it."""
    weld = rigid.model.body_weldid
    return [b for b in range(rigid.model.nbody) if weld[b] == weld[body]]


def _size(rigid: RigidModel, recorded: np.ndarray) -> float:
    """Length by which rods are made [m]: the farthest origin or centre of mass, or the travel of a slide."""
    m = rigid.model
    far = [float(np.linalg.norm(x)) for x in (*m.body_pos[1:], *m.body_ipos[1:])]
    slides = [float(np.ptp(recorded[:, j])) for j, name in enumerate(rigid.joints) if rigid.unit(name) == "m"]
    return max([*far, *slides, LEAST_M]) if max([*far, *slides], default=0.0) > LEAST_M else 0.1


def _rods(element: mujoco.MjsBody, m: mujoco.MjModel, body: int, axis: np.ndarray, size: float) -> None:
    """From a hinge to its children and to the centre of mass; a disc with a hand where that lies on the hinge."""
    children = [b for b in range(1, m.nbody) if int(m.body_parentid[b]) == body]
    ends = [
        np.array(x) for x in (*m.body_pos[children], m.body_ipos[body]) if np.linalg.norm(x) > 0.05 * size
    ]
    if not ends:
        across = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0))
        ends = [size * across / np.linalg.norm(across)]
        half = 0.5 * THIN * size * axis / np.linalg.norm(axis)
        _add(element, mujoco.mjtGeom.mjGEOM_CYLINDER, (-half, half), 0.6 * size, RAIL)
    for end in ends:
        _add(element, mujoco.mjtGeom.mjGEOM_CAPSULE, (np.zeros(3), end), THIN * size, STEEL)
    if not children:
        knob = 1e-3 * THIN * size * axis
        _add(
            element,
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            (ends[-1] - knob, ends[-1] + knob),
            2.5 * THIN * size,
            STEEL,
        )


def _block(spec: mujoco.MjSpec, element: mujoco.MjsBody, m: mujoco.MjModel, j: int, travel: float) -> None:
    """A carriage, and where it stands on the ground a rail of the length that is travelled."""
    body, axis = int(m.jnt_bodyid[j]), np.array(m.jnt_axis[j])
    half = 0.5 * TRAVELS * travel
    _add(element, mujoco.mjtGeom.mjGEOM_CYLINDER, (-half * axis, half * axis), 0.35 * half, STEEL)
    if int(m.body_parentid[body]) == 0:
        start, way = np.array(m.body_pos[body]), 1.6 * travel * axis
        _add(spec.worldbody, mujoco.mjtGeom.mjGEOM_CAPSULE, (start - way, start + way), 0.08 * half, RAIL)


def _add(
    element: mujoco.MjsBody, kind: mujoco.mjtGeom, ends: tuple[np.ndarray, np.ndarray], radius: float,
    rgba: tuple[float, float, float, float],
) -> None:  # fmt: skip
    """A round shape from one end to the other that weighs and touches nothing."""
    element.add_geom(
        type=kind, fromto=[*ends[0], *ends[1]], size=[radius, 0, 0], rgba=rgba, group=0, contype=0, conaffinity=0,
        mass=0,
    )  # fmt: skip
