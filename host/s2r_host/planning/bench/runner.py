"""Jobs of the planning benchmark: one planner, one task, one seed; results as JSON lines that a rerun continues."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.planning.belief import draw_belief
from s2r_host.planning.bench.doubts import doubt_about
from s2r_host.planning.bench.mesh_twin import write_decomposed, write_in_pieces
from s2r_host.planning.bench.planners import Planner, planner_named
from s2r_host.planning.bench.summary import Row
from s2r_host.planning.bench.tasks import draw_task
from s2r_host.planning.bench.verifier import verify
from s2r_host.planning.patience import Patience
from s2r_host.planning.planner import plan_manipulation, scene_of
from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRequest, PlanResult
from s2r_host.planning.tools import tool_named, write_arm_with_tool
from s2r_host.trajectory.deliver import deliver
from s2r_host.trajectory.trajectory import Trajectory
from s2r_host.trajectory.verify import replays
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.conditions import keep_to
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


def jobs(names: list[str], tasks: list[str], placements: int, seeds: int) -> Iterator[Job]:
    """All jobs, planners interleaved: what one side suffers from a busy machine, the other does too."""
    for placement in range(placements):
        for seed in range(seeds):
            for task in tasks:
                for name in names:
                    yield Job(name, task, placement, seed)


@dataclass(frozen=True)
class Conditions:
    """What all jobs of a run share.

    Attributes:
        collection: Which placements; no two share one.
        threads: Of the rollouts.
        replays: Delivered motions are played so many times with believable objects drawn at random.
        attempts: Plans that are tried, with other seeds, until one can be delivered; their time adds up.
        plan_only: No time law, no verifier: a success is what the fine model has held.
        patience_s: A plan that takes longer has failed.
        arm: Which one.
        tool: In its gripper; none if empty.
        doubt: What the objects may differ in, see :mod:`s2r_host.planning.bench.doubts`.
        pieces: The objects' boxes are cut into so many convex meshes; 0: they stay boxes.
        decomposed: Each body of the objects is what CoACD makes of its boxes.
    """

    collection: int
    threads: int
    replays: int = 0
    attempts: int = 3
    plan_only: bool = False
    patience_s: float = 300.0
    arm: str = "xmate3pro"
    tool: str = ""
    pieces: int = 0
    doubt: str = "usual"
    decomposed: bool = False

    def named(self) -> dict[str, Any]:
        """By the names of the options that set them, as they are kept beside the results."""
        options = {"patience_s": "--patience", "decomposed": "--coacd"}
        return {options.get(k, f"--{k.replace('_', '-')}"): v for k, v in asdict(self).items()}


def run(todo: list[Job], results: Path, conditions: Conditions, tell: Callable[[str], None]) -> list[Row]:
    """Run the jobs that ``results`` does not hold yet and append each as one line; returns all asked for.

    Raises:
        UsageError: There is no such arm or tool, or the results that are there were made with other conditions.
    """
    arm = load_arm(conditions.arm)
    tool = tool_named(conditions.tool) if conditions.tool else None
    done = {row["key"]: row for row in read(results)}
    keep_to(conditions.named(), results, begun=bool(done))
    if tool is not None:
        arm = write_arm_with_tool(arm, tool, results.parent / f"arm-{tool.name}")
    for job in todo:
        if job.key in done:
            continue
        tell(job.key)
        planner = planner_named(job.planner)
        task = draw_task(job.task, job.placement, conditions.collection)
        path = task.write(results.parent)
        if conditions.pieces:
            path = write_in_pieces(path, conditions.pieces)
        elif conditions.decomposed:
            path = write_decomposed(path)
        request = PlanRequest(
            arm=arm,
            object_mjcf=path,
            s_initial=task.s_initial,
            s_target=task.s_target,
            q_initial=arm.q_home,
            seed=job.seed,
            settings=replace(
                planner.settings,
                threads=conditions.threads,
                doubt=doubt_about(job.task, conditions.doubt),
            ),
        )
        row = {"key": job.key, **job.__dict__, **_one(request, planner, conditions)}
        done[job.key] = row
        with results.open("a") as file:
            file.write(json.dumps(row) + "\n")
    return [done[job.key] for job in todo]


def read(results: Path) -> list[Row]:
    """The rows of a results file; none if it is not there."""
    return [json.loads(line) for line in results.read_text().splitlines()] if results.is_file() else []


def _one(request: PlanRequest, planner: Planner, conditions: Conditions) -> Row:
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    row: Row = {
        "planned": False,
        "delivered": False,
        "verified": False,
        "steps": 0,
        "env_steps": 0,
    }
    try:
        scene = scene_of(request)
        spent = {"cpu_s": time.process_time() - cpu_s, "wall_s": time.perf_counter() - wall_s}
        for attempt in range(1 if conditions.plan_only else conditions.attempts):
            again = replace(request, seed=request.seed + 1000 * attempt)
            result = plan_manipulation(again, scene, Patience(conditions.patience_s), planner.sampler)
            given_s = result.places_cpu_s if planner.places_free else 0.0
            spent = {
                "cpu_s": spent["cpu_s"] + result.cpu_s - given_s,
                "wall_s": spent["wall_s"] + result.wall_s,
            }
            row |= {
                "planned": result.success, "reason": result.reason, "stage": result.stage, "attempts": attempt + 1,
                "steps": row["steps"] + result.control_steps, "env_steps": row["env_steps"] + result.env_steps,
                "places_cpu_s": result.places_cpu_s,
            }  # fmt: skip
            if conditions.plan_only or not result.success:
                continue
            try:
                row |= _delivered(request, result, scene, planner, conditions)
                break
            except S2RError as error:  # planned again with another seed, as `s2r plan` does
                row["reason"] = str(error)
    except S2RError as error:  # refused, or given up: what that took counts as well
        row["reason"] = str(error)
        spent = {"cpu_s": time.process_time() - cpu_s, "wall_s": time.perf_counter() - wall_s}
    row |= spent
    row["cpu_all_s"], row["wall_all_s"] = time.process_time() - cpu_s, time.perf_counter() - wall_s
    return row


def _delivered(
    request: PlanRequest, result: PlanResult, scene: Scene, planner: Planner, conditions: Conditions
) -> Row:
    """Time, verify and replay a plan."""
    doubts = None if planner.doubted else ()
    delivery = deliver(request, result, None, doubts, scene=scene, accept_fragile=True)
    verdict = verify(delivery.trajectory, request, scene)
    return {
        "delivered": True,
        "fragile": delivery.fragile,
        "verified": verdict.good,
        "held": verdict.held,
        "contacts": verdict.contacts,
        "violations": verdict.violations,
        "worst_hold": verdict.worst_hold,
        "duration_s": delivery.trajectory.duration_s,
        "replays": _replays(delivery.trajectory, request, scene, conditions.replays),
    }


def _replays(trajectory: Trajectory, request: PlanRequest, scene: Scene, count: int) -> list[float]:
    """Final errors as shares of the way, with so many objects at random around the believed one."""
    rng = np.random.default_rng([request.seed, 77])
    way = abs(request.s_target - request.s_initial)
    beliefs = [draw_belief(request.settings.doubt, rng) for _ in range(count)]
    played = replays(trajectory, request, [belief.applied(scene) for belief in beliefs])
    return [one.error / way for one in played]
