"""Numbers from benchmark rows: successes, CPU per held success with intervals, ratios between planners."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import binomtest

Row = dict[str, Any]

_DRAWS = 2000
_LEVELS = (0.05, 0.95)
_FAR = 0.3  # of the way: a replay that ends farther from the target has failed


def summary(rows: list[Row]) -> list[Row]:
    """One line per planner."""
    return [
        _line(name, [row for row in rows if row["planner"] == name])
        for name in dict.fromkeys(row["planner"] for row in rows)
    ]


def by_task(rows: list[Row]) -> list[Row]:
    """One line per planner and task."""
    lines = []
    for task in dict.fromkeys(row["task"] for row in rows):
        lines += [{**line, "task": task} for line in summary([row for row in rows if row["task"] == task])]
    return lines


def _line(name: str, mine: list[Row]) -> Row:
    cpu, wall = np.array([row["cpu_s"] for row in mine]), np.array([row["wall_s"] for row in mine])
    planned = np.array([row["planned"] for row in mine])
    replays = [value for row in mine for value in row.get("replays", ())]
    return {
        "planner": name,
        "plans": len(mine),
        "planned": int(planned.sum()),
        "planned_90": _share(int(planned.sum()), len(mine)),
        "delivered": sum(row["delivered"] for row in mine),
        "verified": sum(row["verified"] for row in mine),
        "cpu_p50_s": float(np.median(cpu)),
        "cpu_p95_s": float(np.quantile(cpu, 0.95)),
        "wall_p50_s": float(np.median(wall)),
        "wall_p95_s": float(np.quantile(wall, 0.95)),
        "cpu_per_success_s": float(cpu.sum() / planned.sum()) if planned.any() else None,
        "cpu_per_success_90": _interval(cpu, planned),
        "cpu_all_p50_s": float(np.median([row["cpu_all_s"] for row in mine])),
        "steps_p50": float(np.median([row["steps"] for row in mine])),
        "env_steps_p50": float(np.median([row["env_steps"] for row in mine])),
        "replays": len(replays),
        "replays_good": sum(abs(value) < _FAR for value in replays),
    }


def _share(count: int, of: int) -> tuple[float, float]:
    """90 % Wilson interval of a share."""
    interval = binomtest(count, of).proportion_ci(0.9, method="wilson")
    return float(interval.low), float(interval.high)


def _interval(cpu: np.ndarray, planned: np.ndarray) -> tuple[float, float] | None:
    """90 % bootstrap interval of the CPU per success [s], or None when some draws have no success."""
    index = np.random.default_rng(0).integers(0, len(cpu), (_DRAWS, len(cpu)))
    successes = planned[index].sum(axis=1)
    if not successes.all():
        return None
    low, high = np.quantile(cpu[index].sum(axis=1) / successes, _LEVELS)
    return float(low), float(high)


def ratios(rows: list[Row], reference: str) -> list[Row]:
    """CPU per held success of every other planner over the reference's, on the jobs that both did.

    The interval draws jobs, not rows: task, placement and seed are the same on both sides. Where a side has no success
    there is no ratio, and no interval where no draw has one: None.
    """
    named = {name: {_job(row): row for row in rows if row["planner"] == name} for name in _names(rows)}
    lines = []
    for name in named:
        both = sorted(named[name].keys() & named.get(reference, {}).keys())
        if name == reference or not both:
            continue
        index = np.random.default_rng(0).integers(0, len(both), (_DRAWS, len(both)))
        index = np.concatenate([np.arange(len(both))[None], index])
        per = {}
        for side in (name, reference):
            cpu = np.array([named[side][job]["cpu_s"] for job in both])[index].sum(axis=1)
            good = np.array([named[side][job]["planned"] for job in both])[index].sum(axis=1)
            per[side] = cpu / np.where(good > 0, good, np.nan)
        ratio = per[name] / per[reference]
        finite = ratio[np.isfinite(ratio)]
        low, high = np.quantile(finite, _LEVELS).tolist() if len(finite) else (None, None)
        told = float(ratio[0]) if np.isfinite(ratio[0]) else None
        lines.append({"planner": name, "jobs": len(both), "ratio": told, "low": low, "high": high})
    return lines


def _names(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(row["planner"] for row in rows))


def _job(row: Row) -> tuple[str, int, int]:
    return row["task"], row["placement"], row["seed"]
