"""``run.json``: inputs, versions, hashes, seeds, timings, results and the reason of the end."""

from __future__ import annotations

import json
import platform
import sys
from dataclasses import asdict, is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.link import ExecutorIdentity
from s2r_host.perception.estimate import JointEstimate
from s2r_host.run.belief import Belief
from s2r_host.run.first_push import DonePush
from s2r_host.run.manipulate import DoneManipulation
from s2r_host.run.observe import Observation
from s2r_host.run.record import Goal, RunRecord
from s2r_protocol.whole_file import write_whole

SCHEMA_VERSION = 1
REPORTED_PACKAGES = (
    "sim2real2",
    "numpy",
    "mujoco",
    "pin",
    "pin-pink",
    "open3d",
    "coacd",
    "toppra",
    "eclipse-zenoh",
)


def write_run_json(record: RunRecord) -> None:
    """Write ``run.json`` into the run's folder; whoever reads it meanwhile finds all of it or nothing."""
    folder = record.settings.out
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(as_json(record), indent=1, allow_nan=False, default=_last_resort)
    write_whole(folder / "run.json", text + "\n")


def as_json(record: RunRecord) -> dict[str, Any]:
    """What ``run.json`` holds."""
    goals = [goal for goal in record.goals if goal.attempts]
    newest = goals[-1] if goals else None
    first = newest.attempts[0] if newest else None
    asked = None if record.settings.target is None else record.origin + record.settings.target
    aimed = record.goals[-1] if record.goals else None  # what the figures of the whole are about
    done = aimed if aimed is not None and aimed.attempts else None
    s_initial = done.attempts[0].s_initial if done else finite(aimed.s_before) if aimed else record.s_found
    return {
        "schema_version": SCHEMA_VERSION,
        "task": record.settings.task.name,
        "unit": "m" if record.settings.task.joint_type == "prismatic" else "rad",
        "ended": record.ended,
        "exit": {"code": int(record.code), "name": record.code.name, "reason": record.reason},
        "target_told": record.target_told,
        "s_target": aimed.target if aimed else asked,
        "s_initial": s_initial,
        "s_final": newest.last.measured.s if newest else record.s_found,
        "s_final_sigma": finite(newest.last.measured.sigma) if newest else None,
        "delta": done.last.delta if done else _left(record),
        "delta_r": done.delta_r if done else None,
        "goals": [_goal(goal) for goal in goals],
        "left_out": [{"s_target": x.target, "reason": x.refused} for x in record.goals if x.refused],
        "tick_before_plan": first.executed[0].tick_start if first and first.executed else None,
        "attempts": [_attempt(attempt) for attempt in record.attempts],
        "push": _push(record.push) if record.push else None,
        "zero_view": record.zero_view,
        "told_view": record.told_view,
        "origin_view": record.origin_view,
        "s_origin": record.origin,
        "s_first": record.s_first,
        "joint_by_push": _told(record.told_by_push) if record.told_by_push else None,
        "push_seen_from": record.push_seen_from,
        "joint": _joint(record.belief) if record.belief else None,
        "physics": [lesson.as_json() for lesson in record.lessons],
        "lost_motion": [lesson.as_json() for lesson in record.lost_motion],
        "views": [_view(view) for view in record.views],
        "stages": [_rounded(asdict(stage)) for stage in record.journal.stages],
        "wall_s": round(record.journal.elapsed_s, 3),
        "verdicts": record.journal.verdicts,
        "warnings": record.journal.warnings,
        "failed_tries": [one.as_json() for one in record.journal.failed_tries],
        "arm": {
            "name": record.arm_name,
            "model_hash": record.model_hash.hex(),
            "limit_hash": record.limit_hash.hex(),
        },
        "executor": _identity(record.identity) if record.identity else None,
        "world_commitment": record.world_commitment,
        "inputs": {"arguments": list(record.arguments), "settings": _plain(record.settings)},
        "versions": _versions(),
    }


def _left(record: RunRecord) -> float | None:
    """δ of a newest target at which the part was already; None of one that it was not moved to."""
    aimed = record.goals[-1] if record.goals else None
    if aimed is None or not abs(aimed.target - aimed.s_before) <= record.settings.task.good_enough:
        return None
    return aimed.target - aimed.s_before


def _goal(goal: Goal) -> dict[str, Any]:
    return {
        "s_target": goal.target,
        "s_initial": goal.attempts[0].s_initial,
        "s_final": goal.last.measured.s,
        "s_final_sigma": finite(goal.last.measured.sigma),
        "delta": goal.last.delta,
        "delta_r": goal.delta_r,
        "attempts": [done.planned.number for done in goal.attempts],
    }


def _attempt(done: DoneManipulation) -> dict[str, Any]:
    planned = done.planned
    result = planned.result
    return {
        "number": planned.number,
        "s_initial": done.s_initial,
        "s_target": done.s_target,
        "s_planned": done.foreseen,
        "s_final": done.measured.s,
        "s_final_sigma": finite(done.measured.sigma),
        "delta": done.delta,
        "delta_r": done.delta_r,
        "tick_start": done.executed[0].tick_start if done.executed else None,
        "plan_seqs": [executed.seq for executed in done.executed],
        "duration_s": planned.delivery.trajectory.duration_s,
        "pushed_geom": planned.end.geom,
        "escape_clearance_m": planned.escape.clearance_m,
        "planner": {
            "seed": planned.request.seed,
            "stage": result.stage,
            "control_steps": result.control_steps,
            "env_steps": result.env_steps,
            "cpu_s": result.cpu_s,
            "wall_s": result.wall_s,
            "torque_share": result.torque_share,
            "replay_corrections": planned.delivery.corrections,
        },
        "measurement": _plain(done.measured),
    }


def _push(done: DonePush) -> dict[str, Any]:
    motion = done.planned.motion
    return {
        "direction": motion.proposal.direction,
        "contact_m": motion.proposal.p_contact,
        "depth_m": float(np.linalg.norm(motion.proposal.p_end - motion.proposal.p_contact)),
        "proposals_tried": motion.tried,
        "tick_start": done.executed[0].tick_start if done.executed else None,
        "plan_seqs": [executed.seq for executed in done.executed],
    }


def _told(estimate: JointEstimate) -> dict[str, Any]:
    return {
        "joint_type": estimate.joint_type,
        "axis_origin_m": estimate.axis_origin_m,
        "axis_direction": estimate.axis_direction,
        "delta": estimate.delta,
        "unit": estimate.unit,
        "intervals90": _plain(estimate.intervals90),
        "residual_m": estimate.residual_m,
        "explained": estimate.explained,
    }


def _joint(belief: Belief) -> dict[str, Any]:
    model = belief.model
    return {
        **_told(belief.estimate),
        "model_mjcf": model.mjcf_path,
        "model_urdf": model.urdf_path,
        "believed_mjcf": {"growing": belief.growing, "falling": belief.falling},
        "mass_kg": model.mass_kg,
        "range": model.range,
        "shifts": belief.shifts,
        "felt": _plain(belief.felt) if belief.felt is not None else None,
    }


def _view(view: Observation) -> dict[str, Any]:
    return {
        "name": view.name,
        "camera_stamp_ns": view.capture.stamp_ns,
        "camera_index": view.capture.index,
        "object_points": len(view.scene.p_base),
        "arm_pixels": int(view.arm_mask.sum()),
        "q_meas": view.q_meas,
    }


def _identity(identity: ExecutorIdentity) -> dict[str, Any]:
    return {
        "boot_id": f"{identity.boot_id:016x}",
        "arm": identity.arm,
        "model_hash": identity.model_hash.hex(),
        "limit_hash": identity.limit_hash.hex(),
        "tick_ns": identity.tick_ns,
        "software": identity.software,
        "host_timeout_s": identity.host_timeout_s,
    }


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "platform": sys.platform}
    for package in REPORTED_PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


def finite(value: float) -> float | None:
    """A number as JSON can say it: None where it is not known."""
    return float(value) if np.isfinite(value) else None


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {key: round(value, 4) if isinstance(value, float) else value for key, value in values.items()}


def _plain(value: Any) -> Any:
    """Dataclasses, arrays and paths as plain JSON values; infinities as null."""
    if is_dataclass(value) and not isinstance(value, type):
        return {key: _plain(item) for key, item in vars(value).items()}
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return finite(value)
    return _last_resort(value) if isinstance(value, (np.ndarray, np.generic, Path)) else value


def _last_resort(value: object) -> Any:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, Path):
        return str(value.resolve())  # whoever reads it is elsewhere
    raise TypeError(f"{type(value).__name__} does not belong into run.json")
