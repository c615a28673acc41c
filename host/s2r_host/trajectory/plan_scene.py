"""One scene file in, a folder with the plan out: what ``s2r plan`` does."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.plan_process import PLAN_FILES, WRITING, refusal
from s2r_host.planning.patience import Patience
from s2r_host.planning.planner import scene_of
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import PlanSettings
from s2r_host.planning.staying import creeping
from s2r_host.planning.task import PlanRequest
from s2r_host.trajectory.legs import plan_legs
from s2r_host.trajectory.legs_joined import Leg, LeggedPlan
from s2r_host.trajectory.picture_strip import save_picture_strip
from s2r_host.trajectory.plan_files import (
    write_knots_csv,
    write_model,
    write_plan_csv,
    write_plan_mcap,
    write_trace_csv,
)
from s2r_host.trajectory.verify import trace_of
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import S2RError, UsageError
from s2r_protocol.targets import JointType, units_of


@dataclass(frozen=True, eq=False)
class PlanTask:
    """What ``s2r plan`` is asked.

    Attributes:
        scene: MJCF file; scene and object start at their ``qpos0``.
        joint: The object's joint.
        s_target: Where it shall end [m or rad].
        target_type: Kind of joint that the unit of the target belongs to; None: it had no unit.
        arm: The arm that is put at ``arm_base``, or that the scene holds.
        out: Folder for the results; made if it is not there.
        q_initial: The arm's start pose [rad], (dof,); None: its home.
        seed: Of all chance.
        settings: Of the planner.
        doubt_files: Answers of ``s2r build-model`` and ``s2r gap`` whose intervals the plan should hold for.
    """

    scene: Path
    joint: str
    s_target: float
    arm: ArmDescription
    out: Path
    q_initial: np.ndarray | None = None
    seed: int = 0
    target_type: JointType | None = None
    settings: PlanSettings = field(default_factory=PlanSettings)
    doubt_files: tuple[Path, ...] = ()


def plan_scene(task: PlanTask, patience: Patience) -> dict[str, Any]:
    """Plan, time, replay and write everything into ``task.out``; returns what ``plan.json`` holds.

    A refusal leaves a ``plan.json`` with ``success`` false and the reason, and goes on to the caller.

    Raises:
        S2RError: The request was refused, or a file cannot be used; the text is the reason.
    """
    task.out.mkdir(parents=True, exist_ok=True)
    for name in PLAN_FILES:
        (task.out / name).unlink(missing_ok=True)  # of an earlier plan, which this one may not replace
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    try:
        patience.check("reading the scene")
        request = _request(task)
        scene = scene_of(request)
        _check_unit(task, scene)
        settings = task.settings
        if task.doubt_files:
            from s2r_host.planning.doubt_files import doubt_from_files  # perception takes its time to import

            doubt = doubt_from_files(task.doubt_files, scene, settings.doubt)
            settings = replace(settings, doubt=doubt)
        request = replace(request, s_initial=float(scene.fine.qpos0[scene.s_qpos]), settings=settings)
        plan = plan_legs(request, scene=scene, patience=patience, accept_fragile=True)
    except S2RError as error:
        answer = _refusal(task, str(error), patience)
        _finish(task, answer, cpu_s, wall_s)
        raise
    answer = _answer(task, request, scene, plan, patience)
    answer["cpu_s"], answer["wall_s"] = _since(cpu_s, wall_s)
    patience.tell(WRITING)
    _write_all(task, request, scene, plan)
    _save(task, answer)
    return answer


def _check_unit(task: PlanTask, scene: Scene) -> None:
    joint_type: JointType = "prismatic" if scene.prismatic else "revolute"
    if task.target_type not in (None, joint_type):
        kind = "slide" if scene.prismatic else "hinge"
        raise UsageError(f"--target: joint {task.joint!r} is a {kind}, measured in {units_of(joint_type)}")


def _request(task: PlanTask) -> PlanRequest:
    q_initial = task.arm.q_home if task.q_initial is None else task.q_initial
    return PlanRequest(
        arm=task.arm,
        object_mjcf=task.scene,
        s_initial=0.0,  # until the scene has been read
        s_target=task.s_target,
        q_initial=q_initial,
        joint=task.joint,
        seed=task.seed,
        in_scene=True,
        settings=task.settings,
    )


def _write_all(task: PlanTask, request: PlanRequest, scene: Scene, plan: LeggedPlan) -> None:
    delivery = plan.delivery
    names = task.arm.joint_names
    write_plan_csv(task.out / "plan.csv", delivery.trajectory, names)
    write_knots_csv(task.out / "knots.csv", delivery.trajectory, names)
    write_plan_mcap(
        task.out / "plan.mcap", delivery.trajectory, task.arm, f"{task.joint} to {task.s_target:g}"
    )
    write_trace_csv(task.out / "trace.csv", trace_of(delivery.trajectory, request, scene), names)
    write_model(task.out / "model", request, scene)
    save_picture_strip(
        task.out / "strip.png",
        scene,
        delivery.trajectory,
        delivery.replay,
        np.asarray(request.q_initial, dtype=float),
        request.s_initial,
        tuple(leg.start_s for leg in plan.legs),
    )


def _answer(
    task: PlanTask,
    request: PlanRequest,
    scene: Scene,
    plan: LeggedPlan,
    patience: Patience,
) -> dict[str, Any]:
    delivery, played = plan.delivery, plan.delivery.replay
    return {
        "success": True,
        "held": played.held,
        "final": played.final,
        "error": played.error,
        "control_steps": patience.control_steps,
        "cpu_s": 0.0,
        "wall_s": 0.0,
        "seed": task.seed,
        "reason": "held on target",
        **_task_fields(task),
        "unit": "m" if scene.prismatic else "rad",
        "s_initial": request.s_initial,
        "duration_s": delivery.trajectory.duration_s,
        "stage": max(leg.result.stage for leg in plan.legs),
        "followed": delivery.followed,
        "torque_share": played.torque_share,
        "press_N": played.press_N,
        "fragile": delivery.fragile,
        "creeps": creeping(request, scene),
        "ensemble": request.settings.ensemble,
        "doubt": request.settings.doubt.as_json(),
        "X_scene_base": scene.X_scene_base.tolist(),
        "legs": [_leg(leg) for leg in plan.legs],
    }


def _leg(leg: Leg) -> dict[str, Any]:
    """One place's share of the plan; times are those of ``plan.csv``."""
    return {
        "start_s": leg.start_s,
        "end_s": leg.end_s,
        "s_initial": leg.request.s_initial,
        "s_target": leg.request.s_target,
        "final": leg.delivery.replay.final,
        "s_left": leg.left.s if leg.left is not None else None,
        "p_part": leg.result.p_part.tolist(),
        "stage": leg.result.stage,
        "followed": leg.delivery.followed,
    }


def _refusal(task: PlanTask, reason: str, patience: Patience) -> dict[str, Any]:
    return {**refusal(reason, task.seed, patience.control_steps), **_task_fields(task)}


def _task_fields(task: PlanTask) -> dict[str, Any]:
    target = task.s_target if np.isfinite(task.s_target) else str(task.s_target)  # JSON knows no NaN
    return {"scene": str(task.scene), "joint": task.joint, "target": target, "arm": task.arm.name}


def _since(cpu_s: float, wall_s: float) -> tuple[float, float]:
    return time.process_time() - cpu_s, time.perf_counter() - wall_s


def _finish(task: PlanTask, answer: dict[str, Any], cpu_s: float, wall_s: float) -> None:
    answer["cpu_s"], answer["wall_s"] = _since(cpu_s, wall_s)
    _save(task, answer)


def _save(task: PlanTask, answer: dict[str, Any]) -> None:
    (task.out / "plan.json").write_text(json.dumps(answer, indent=1) + "\n")
