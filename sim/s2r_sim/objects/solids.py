"""Simple solids and joints from which all kinds of object are put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_sim.objects.naming import BASE_BODY, JOINT, PART_BODY
from s2r_sim.objects.parameters import Rgb, Standing

STIFF = [0.004, 1.0]  # MuJoCo solref: time constant [s], damping ratio
# MuJoCo solimp of dry friction. A softer one lets a lid creep: 0.99 by 0.04 °/s, this one by a hundredth of that.
HARD = [0.9999, 0.9999, 0.0001, 0.5, 2]

Point = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Finish:
    """How a surface looks and rubs."""

    rgb: Rgb
    friction: float


def stand(world: mujoco.MjSpec, spec: Standing) -> tuple[mujoco.MjsBody, mujoco.MjsBody]:
    """Bodies ``object_base`` at the object's place and ``object_part`` in it, which do not collide with each other."""
    half_turn = np.pi + spec.yaw_rad  # object x looks at the arm
    base = world.worldbody.add_body(
        name=BASE_BODY,
        pos=[spec.x_m, spec.y_m, 0.0],
        quat=[np.cos(half_turn / 2), 0.0, 0.0, np.sin(half_turn / 2)],
    )
    part = base.add_body(name=PART_BODY)
    world.add_exclude(bodyname1=BASE_BODY, bodyname2=PART_BODY)  # the joint guides the part, not the walls
    return base, part


def box(
    body: mujoco.MjsBody, name: str, low: Point, high: Point, finish: Finish, quat_wxyz: Point | None = None
) -> mujoco.MjsGeom:
    """The box between two corners; a quaternion turns it about its centre."""
    a, b = np.array(low, dtype=float), np.array(high, dtype=float)
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(a + b) / 2,
        size=np.abs(b - a) / 2,
        quat=[1.0, 0.0, 0.0, 0.0] if quat_wxyz is None else list(quat_wxyz),
        rgba=[*finish.rgb, 1.0],
        friction=[finish.friction, 0.005, 0.0001],
    )


def rod(
    body: mujoco.MjsBody,
    name: str,
    start: Point,
    end: Point,
    radius_m: float,
    finish: Finish,
    round_ends: bool = False,
) -> mujoco.MjsGeom:
    """A cylinder between two points, or a capsule."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    z = (b - a) / np.linalg.norm(b - a)
    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE if round_ends else mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=(a + b) / 2,
        size=[radius_m, float(np.linalg.norm(b - a)) / 2, 0.0],
        quat=quat_z_to(z),
        rgba=[*finish.rgb, 1.0],
        friction=[finish.friction, 0.005, 0.0001],
    )


def bar(
    body: mujoco.MjsBody, name: str, start: Point, end: Point, width_m: float, thick_m: float, finish: Finish
) -> mujoco.MjsGeom:
    """A flat bar along a line: ``width_m`` in the horizontal direction across it, ``thick_m`` the other way."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    x = (b - a) / np.linalg.norm(b - a)
    up = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.95 else np.array([1.0, 0.0, 0.0])
    y = np.cross(up, x)
    y /= np.linalg.norm(y)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([x, y, np.cross(x, y)]).ravel())
    half = np.array([np.linalg.norm(b - a), width_m, thick_m]) / 2
    middle = (a + b) / 2
    return box(body, name, middle - half, middle + half, finish, quat)


def quat_z_to(z: np.ndarray) -> np.ndarray:
    """Quaternion (w, x, y, z) that turns the z axis to the unit vector ``z``."""
    quat = np.empty(4)
    mujoco.mju_quatZ2Vec(quat, z)
    return quat


def share_mass(geoms: Sequence[mujoco.MjsGeom], mass_kg: float) -> None:
    """Spread a mass over solids in proportion to their volume."""
    volume = np.array([_volume(geom) for geom in geoms])
    for geom, share in zip(geoms, volume / volume.sum(), strict=True):
        geom.mass = mass_kg * float(share)


def _volume(geom: mujoco.MjsGeom) -> float:
    a, b, c = geom.size
    if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
        return 8 * a * b * c
    caps = 4 / 3 * np.pi * a**3 if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
    return 2 * np.pi * a * a * b + caps


def hinge(part: mujoco.MjsBody, spec: Standing, anchor: Point, axis: Point) -> None:
    """The joint of a part that turns; the axis passes the anchor (object frame)."""
    _joint(part, spec, mujoco.mjtJoint.mjJNT_HINGE, axis, anchor, armature=0.0005)


def slide(part: mujoco.MjsBody, spec: Standing, axis: Point, name: str = JOINT) -> None:
    """The joint of a part that slides."""
    _joint(part, spec, mujoco.mjtJoint.mjJNT_SLIDE, axis, (0.0, 0.0, 0.0), armature=0.02, name=name)


def _joint(
    part: mujoco.MjsBody,
    spec: Standing,
    kind: mujoco.mjtJoint,
    axis: Point,
    anchor: Point,
    armature: float,
    name: str = JOINT,
) -> None:
    part.add_joint(
        name=name,
        type=kind,
        pos=list(anchor),
        axis=list(axis),
        range=[0.0, spec.q_max],  # radians: every world here is compiled with them
        limited=True,
        damping=[spec.damping, 0, 0],
        frictionloss=spec.coulomb,
        armature=armature,
        solref_friction=STIFF,  # below Coulomb friction the part must not creep
        solimp_friction=HARD,
    )
