"""What a trial came to: the sealed truth beside what the host said, and the stage that failed."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from s2r_sim.paper.miss import terms_of_error
from s2r_sim.paper.trials import Trial
from s2r_sim.score import Truth, read_truth, sense, true_joint
from s2r_sim.world import load_world

Row = dict[str, Any]
MOVING_RAD_S = 2e-3
BETWEEN = "between stages"


def score_trial(trial: Trial, folder: Path, change: float) -> Row:
    """The row of one trial whose processes have ended.

    Joint values are the sealed ones [m or rad]; ``delta`` is what was asked for minus what was done after the last
    planned manipulation, ``delta_first`` after the first, both None if none was begun. ``terms`` are those of
    ``delta``, see :mod:`s2r_sim.paper.miss`.

    Args:
        trial: With the world.
        folder: Its files.
        change: What was asked for, counted as the host's joint.

    Raises:
        TruthFileError, WorldFileError: A file is missing or damaged.
    """
    truth = read_truth(folder / "truth.csv")
    run = json.loads((folder / "run/run.json").read_text())
    begun = [
        truth.s_at_tick(entry["tick_start"]) for entry in run["attempts"] if entry["tick_start"] is not None
    ]
    row: Row = {
        "change": change,
        "exit": run["exit"]["code"],
        "reason": run["exit"]["reason"],
        "stage": failed_stage(run),
        "pushes": sum(entry["name"].startswith("B") for entry in run["views"]),
        "manipulations": len(begun),
        "wall_s": run["wall_s"],
        "moving_s": _moving_s(truth),
        "s_found": float(truth.s[0]),
        "s_end": float(truth.s[-1]),
        "delta": None,
        "delta_first": None,
        "delta_measured": run["delta"],
        "commitment_holds": _seal_holds(trial, folder, run),
        **_joint_error(trial, run, begun[0] - float(truth.s[0]) if begun else None),
    }
    if begun:
        target = begun[0] + sense(trial.world, run) * change
        row["s_pushed"] = begun[0]
        row["delta"] = target - float(truth.s[-1])
        row["delta_first"] = target - (begun[1] if len(begun) > 1 else float(truth.s[-1]))
        row["terms"] = terms_of_error(
            trial.world, run, begun, float(truth.s[-1]), change, _touched_at(truth, run)
        )
    return row


def _touched_at(truth: Truth, run: Row) -> float:
    """True joint value when the newest push began; as found where a run of earlier code does not say when that was."""
    tick = (run["push"] or {}).get("tick_start")
    return float(truth.s[0]) if tick is None else truth.s_at_tick(tick)


def _seal_holds(trial: Trial, folder: Path, run: Row) -> bool:
    """Whether the world is the one that was drawn, and the one whose hash the host was told with its first picture."""
    drawn = trial.world.commitment
    told = run["world_commitment"] or drawn  # a run that saw no picture was told of none
    return load_world(folder / "world.json").commitment == drawn == told


def _moving_s(truth: Truth) -> float:
    """Simulated time in which the arm moved [s]: lock-step lets it rest for as long as the machine likes."""
    step = np.diff(truth.t)
    speed = np.abs(np.diff(truth.q, axis=0)).max(axis=1) / np.maximum(step, 1e-9)
    return round(float(step[speed > MOVING_RAD_S].sum()), 2)


def failed_stage(run: Row) -> str | None:
    """Name of the stage that ended the run, numbers left out; None if it went through."""
    if run["exit"]["code"] in (0, 7):
        return None
    failed = [stage["name"] for stage in run["stages"] if stage["failed"]]
    if not failed:
        return BETWEEN
    name = re.sub(r" \d+", "", failed[-1])
    return name.replace(": proposals", " not reachable")


def _joint_error(trial: Trial, run: Row, moved: float | None) -> Row:
    """Errors of the estimated joint: axis [rad], distance of the lines [m] (hinges), motion seen [m or rad]."""
    if run["joint_by_push"] is None:
        return {"axis_error_rad": None, "axis_offset_m": None, "push_error": None}
    origin, direction = true_joint(trial.world)
    said = np.array(run["joint_by_push"]["axis_direction"])
    along = float(said @ direction)
    offset = np.array(run["joint_by_push"]["axis_origin_m"]) - origin
    distance = float(np.linalg.norm(offset - (offset @ direction) * direction))
    if run["push_seen_from"] != "A":  # the motion seen began later than the true one
        moved = None
    signed = moved if moved is None or along >= 0.0 else -moved
    return {
        "axis_error_rad": float(np.arccos(min(1.0, abs(along)))),
        "axis_offset_m": None if trial.kind == "drawer" else distance,
        "push_error": None if signed is None else run["joint_by_push"]["delta"] - signed,
    }
