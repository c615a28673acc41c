"""What ``s2r plan`` leaves behind: the trajectory, the fine model's trace, the model itself."""

from __future__ import annotations

import csv
import shutil
import warnings
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.planning.scene import Scene, SceneFileError
from s2r_host.planning.scene_file import read_scene
from s2r_host.planning.scene_spec import fine_model_spec
from s2r_host.planning.task import PlanRequest
from s2r_host.trajectory.trajectory import Trajectory
from s2r_host.trajectory.verify import Trace
from s2r_protocol.arms import ArmDescription

SAMPLE_S = 0.002


def write_plan_csv(path: Path, trajectory: Trajectory, joint_names: tuple[str, ...]) -> Path:
    """Write the trajectory as ``t, q.<joint>...`` [s, rad] every 2 ms, its end included."""
    t = np.arange(0.0, trajectory.duration_s, SAMPLE_S)
    if trajectory.duration_s - t[-1] > 1e-6:
        t = np.append(t, trajectory.duration_s)
    q, _, _ = trajectory.sample(t)
    header = ["t", *(f"q.{name}" for name in joint_names)]
    _write(path, header, np.column_stack([t, q]))
    return path


def write_knots_csv(path: Path, trajectory: Trajectory, joint_names: tuple[str, ...]) -> Path:
    """Write the quintic knots as the executor gets them: ``t``, then ``q.``, ``dq.``, ``ddq.`` of every joint."""
    header = ["t", *(f"{kind}.{name}" for kind in ("q", "dq", "ddq") for name in joint_names)]
    _write(path, header, np.column_stack([trajectory.t, trajectory.q, trajectory.dq, trajectory.ddq]))
    return path


def write_plan_mcap(path: Path, trajectory: Trajectory, arm: ArmDescription, label: str) -> Path:
    """Write the trajectory as a recording with one plan, which `s2r replay` sends to an arm with these joints."""
    from s2r_host.recording import RunRecorder  # takes a tenth of a second, which a refusal does not need

    with RunRecorder(path, f"/plan/{arm.name}", arm.joint_names, arm) as recorder:
        recorder.add_plan(trajectory, label, 0)
    return path


def write_trace_csv(path: Path, trace: Trace, joint_names: tuple[str, ...]) -> Path:
    """Write what the fine model did at each of its substeps, from the start to the end of the hold."""
    header = [
        "t", "s", "ds", "touch",
        *(f"{kind}.{name}" for kind in ("q_ref", "q_meas", "tau") for name in joint_names),
    ]  # fmt: skip
    columns = [trace.t, trace.s, trace.ds, trace.touch, trace.q_ref, trace.q_meas, trace.tau]
    _write(path, header, np.column_stack(columns))
    return path


def _write(path: Path, header: list[str], rows: np.ndarray) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([f"{value:.9g}" for value in row] for row in rows)


def write_model(folder: Path, request: PlanRequest, scene: Scene) -> Path:
    """Write arm and scene as the fine model has them: ``scene.xml`` with ``assets/``, and ``scene.mjb``.

    The world frame is the arm's base frame. Files of meshes and height fields are copied.

    Raises:
        SceneFileError: The written file does not give the model that was planned in.
    """
    folder.mkdir(parents=True, exist_ok=True)
    given = read_scene(request.object_mjcf, request.joint, request.arm) if request.in_scene else None
    spec = fine_model_spec(request.arm, request.object_mjcf, request.joint, request.settings, given)
    _freeze_inertias(spec, scene.fine)
    assets = folder / "assets"
    for number, thing in enumerate((*spec.meshes, *spec.hfields)):
        if thing.file:
            assets.mkdir(exist_ok=True)
            name = f"{number:03d}_{Path(thing.file).name}"
            shutil.copyfile(thing.file, assets / name)
            thing.file = str((assets / name).resolve())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        spec.compile()
        text = spec.to_xml()
    path = folder / "scene.xml"
    path.write_text(text.replace(f"{assets.resolve()}/", "assets/"))
    mujoco.mj_saveModel(scene.fine, str(folder / "scene.mjb"))
    _compare(path, scene.fine)
    return path


def _freeze_inertias(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Write the compiled inertias down: how a scene infers them from its geoms is lost when it is written."""
    for body in spec.bodies[1:]:
        if not body.name:
            continue
        k = model.body(body.name).id
        if model.body_mass[k] <= 0.0:
            continue
        body.explicitinertial = True
        body.mass, body.inertia = float(model.body_mass[k]), model.body_inertia[k]
        body.ipos, body.iquat = model.body_ipos[k], model.body_iquat[k]
        body.fullinertia = [np.nan] * 6


def _compare(path: Path, model: mujoco.MjModel) -> None:
    try:
        again = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise SceneFileError(f"{path}: the written model cannot be read back: {error}") from error
    for field in (
        "body_mass",
        "body_inertia",
        "jnt_range",
        "dof_damping",
        "dof_frictionloss",
        "geom_size",
        "geom_contype",
    ):
        here, there = getattr(model, field), getattr(again, field)
        if here.shape != there.shape or not np.allclose(here, there, rtol=1e-4, atol=1e-7):
            raise SceneFileError(f"{path}: the written model differs from the one planned in: {field}")
