"""Jobs of the planning benchmark: one planner, one task, one seed; results as JSON lines that a rerun continues."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.planning.bench.tasks import BenchTask, draw_task
from s2r_host.planning.bench.verifier import verify
from s2r_host.planning.patience import Patience
from s2r_host.planning.planner import plan_manipulation, scene_of
from s2r_host.planning.settings import PlanSettings, paper_settings
from s2r_host.planning.task import PlanRequest, PlanResult
from s2r_host.trajectory.deliver import deliver
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import S2RError


@dataclass(frozen=True)
class Job:
    """One plan to make."""

    planner: str
    task: str
    placement: int
    seed: int

    @property
    def key(self) -> str:
        """Name in the results file."""
        return f"{self.planner}/{self.task}/{self.placement}/{self.seed}"


def planners() -> dict[str, PlanSettings]:
    """Settings by name: ours, the paper's, and ours with one thing switched off."""
    ours = PlanSettings()
    icem, weights = ours.icem, ours.weights

    def one_stage(settings: PlanSettings) -> PlanSettings:
        return replace(settings, cascade=settings.cascade[:1])

    return {
        "ours": ours,
        "paper": paper_settings(),
        "no_cascade": one_stage(ours),
        "white_noise": one_stage(replace(ours, icem=replace(icem, noise_beta=0.0, knots=None))),
        "no_elite_memory": one_stage(
            replace(ours, icem=replace(icem, keep_elites=False, shift_elites=False))
        ),
        "execute_mean": one_stage(replace(ours, icem=replace(icem, execute_best=False))),
        "no_proposals": one_stage(replace(ours, proposal_speeds=())),
        "no_lead_in": one_stage(replace(ours, lead_in=False)),
        "no_r_dist": one_stage(replace(ours, weights=replace(weights, distance=0.0))),
        "no_r_target": one_stage(replace(ours, weights=replace(weights, target=0.0))),
        "no_r_contact": one_stage(replace(ours, weights=replace(weights, contact=0.0, collision=0.0))),
        "no_r_reg": one_stage(replace(ours, weights=replace(weights, speed=0.0, acceleration=0.0))),
        "no_r_success": one_stage(replace(ours, weights=replace(weights, success=0.0))),
        "no_r_press": one_stage(replace(ours, weights=replace(weights, press=0.0))),
    }


def jobs(names: list[str], tasks: list[str], placements: int, seeds: int) -> Iterator[Job]:
    """All jobs, planners interleaved: what one side suffers from a busy machine, the other does too."""
    for placement in range(placements):
        for seed in range(seeds):
            for task in tasks:
                for name in names:
                    yield Job(name, task, placement, seed)


def run(
    todo: list[Job], results: Path, collection: int, threads: int, tell: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Run the jobs that ``results`` does not hold yet and append each as one line; returns all asked for."""
    results.parent.mkdir(parents=True, exist_ok=True)
    done = {row["key"]: row for row in read(results)}
    arm, settings = load_arm("xmate3pro"), planners()
    for job in todo:
        if job.key in done:
            continue
        tell(job.key)
        task = draw_task(job.task, job.placement, collection)
        path = task.write(results.parent)
        request = PlanRequest(
            arm=arm,
            object_mjcf=path,
            s_initial=task.s_initial,
            s_target=task.s_target,
            q_initial=arm.q_home,
            seed=job.seed,
            settings=replace(settings[job.planner], threads=threads),
        )
        row = {"key": job.key, **job.__dict__, **_one(request, task)}
        done[job.key] = row
        with results.open("a") as file:
            file.write(json.dumps(row) + "\n")
    return [done[job.key] for job in todo]


def read(results: Path) -> list[dict[str, Any]]:
    """The rows of a results file; none if it is not there."""
    return [json.loads(line) for line in results.read_text().splitlines()] if results.is_file() else []


def _one(request: PlanRequest, task: BenchTask) -> dict[str, Any]:
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    row: dict[str, Any] = {
        "planned": False,
        "delivered": False,
        "verified": False,
        "steps": 0,
        "env_steps": 0,
    }
    result: PlanResult | None = None
    try:
        scene = scene_of(request)
        result = plan_manipulation(request, scene, Patience(120.0))
        row |= {
            "planned": result.success, "reason": result.reason, "stage": result.stage,
            "steps": result.control_steps, "env_steps": result.env_steps,
        }  # fmt: skip
        row |= {"cpu_s": time.process_time() - cpu_s, "wall_s": time.perf_counter() - wall_s}
        if result.success:
            delivery = deliver(request, result, scene=scene, accept_fragile=True)
            verdict = verify(delivery.trajectory, request, scene)
            row |= {
                "delivered": True, "fragile": delivery.fragile, "verified": verdict.good, "held": verdict.held,
                "contacts": verdict.contacts, "violations": verdict.violations, "worst_hold": verdict.worst_hold,
                "duration_s": delivery.trajectory.duration_s,
            }  # fmt: skip
    except S2RError as error:
        row["reason"] = str(error)
    row.setdefault("cpu_s", time.process_time() - cpu_s)
    row.setdefault("wall_s", time.perf_counter() - wall_s)
    row["cpu_all_s"], row["wall_all_s"] = time.process_time() - cpu_s, time.perf_counter() - wall_s
    return row


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One line per planner: successes, CPU and wall time, CPU per held success."""
    lines = []
    for name in dict.fromkeys(row["planner"] for row in rows):
        mine = [row for row in rows if row["planner"] == name]
        cpu, wall = np.array([row["cpu_s"] for row in mine]), np.array([row["wall_s"] for row in mine])
        planned = sum(row["planned"] for row in mine)
        lines.append(
            {
                "planner": name,
                "plans": len(mine),
                "planned": planned,
                "delivered": sum(row["delivered"] for row in mine),
                "verified": sum(row["verified"] for row in mine),
                "cpu_p50_s": float(np.median(cpu)),
                "cpu_p95_s": float(np.quantile(cpu, 0.95)),
                "wall_p50_s": float(np.median(wall)),
                "wall_p95_s": float(np.quantile(wall, 0.95)),
                "cpu_per_success_s": float(cpu.sum() / planned) if planned else None,
                "cpu_all_p50_s": float(np.median([row["cpu_all_s"] for row in mine])),
            }
        )
    return lines
