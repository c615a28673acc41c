"""An object alone on a table: MuJoCo model, true joint, and files for other tools."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from s2r_sim.objects.catalogue import KINDS, ObjectSpec, add_object
from s2r_sim.objects.naming import JOINT

TABLE_RGBA = (0.42, 0.44, 0.46, 1.0)


@dataclass(frozen=True)
class JointTruth:
    """The joint as it is.

    Attributes:
        joint_type: "revolute" or "prismatic".
        origin_m: A point on the axis, arm base frame.
        direction: Unit vector; positive joint values move along or about it.
        q_start, q_max, q_min: As found, upper and lower stop [m or rad].
    """

    joint_type: Literal["revolute", "prismatic"]
    origin_m: tuple[float, float, float]
    direction: tuple[float, float, float]
    q_start: float
    q_max: float
    q_min: float = 0.0


def table_scene(spec: ObjectSpec) -> mujoco.MjSpec:
    """The object on a table, without an arm."""
    scene = mujoco.MjSpec()
    scene.modelname = spec.kind
    scene.compiler.degree = False
    scene.option.timestep = 0.001
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    add_table(scene)
    add_object(scene, spec)
    return scene


def add_table(scene: mujoco.MjSpec) -> None:
    """The plane z = 0."""
    scene.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[2.0, 2.0, 0.1],
        rgba=TABLE_RGBA,
        friction=[0.5, 0.005, 0.0001],
    )


def qpos_at(model: mujoco.MjModel, q: float) -> np.ndarray:
    """Positions of the whole scene with the object's joint at ``q`` (rail play centred), shape (nq,)."""
    qpos = model.qpos0.copy()
    qpos[model.joint(JOINT).qposadr[0]] = q
    return qpos


def joint_truth(model: mujoco.MjModel, spec: ObjectSpec) -> JointTruth:
    """The joint of the object as found."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos_at(model, spec.q_start)
    mujoco.mj_kinematics(model, data)
    joint = model.joint(JOINT).id
    x, y, z = data.xanchor[joint].tolist()
    a, b, c = data.xaxis[joint].tolist()
    slides = KINDS[spec.kind].slides
    return JointTruth("prismatic" if slides else "revolute", (x, y, z), (a, b, c), spec.q_start, spec.q_max)


def write_object(spec: ObjectSpec, folder: Path) -> None:
    """Write ``scene.xml`` (MJCF) and ``object.json`` (parameters and true joint) for inspection or other tools."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = table_scene(spec)
    scene.worldbody.add_site(name="arm_base")  # objects are placed in the frame of the arm's base
    model = scene.compile()
    (folder / "scene.xml").write_text(scene.to_xml())
    content = {"parameters": spec.model_dump(mode="json"), "joint": asdict(joint_truth(model, spec))}
    (folder / "object.json").write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")
