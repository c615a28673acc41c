"""What a plan's rollouts cost: share of raw batch throughput, threads, samples, horizon, contacts, convex pieces.

`python tests/bench/bench_planning_cost.py` prints Markdown tables; everything in one process, interleaved, best of the
rounds for a rate (other jobs only ever make it slower), CPU seconds of all threads besides.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import mujoco.batch
import numpy as np

from s2r_host.planning import IcemSettings, PlanRequest, PlanSettings, Stage
from s2r_host.planning.bench.mesh_twin import write_in_pieces
from s2r_host.planning.bench.tasks import draw_task
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.hooking import find_hooks
from s2r_host.planning.lookahead import Lookahead
from s2r_host.planning.planner import plan_manipulation, scene_of
from s2r_host.planning.rewards import Task
from s2r_host.planning.sampler import icem_sampler
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")


class Bench:
    """One task, at the state in which the fingertip is behind the part."""

    def __init__(self, folder: Path, name: str, pieces: int = 1) -> None:
        task = draw_task(name, 0, 0)
        path = task.write(folder)
        if pieces > 1:
            path = write_in_pieces(path, pieces)
        self.request = PlanRequest(
            ARM, path, s_initial=task.s_initial, s_target=task.s_target, q_initial=ARM.q_home
        )
        self.scene = scene_of(self.request)
        self.world = FineWorld(self.scene, ARM.q_home, task.s_initial)
        self.hook = find_hooks(self.scene, self.world, path, task.s_target, PlanSettings(threads=1))[0]
        self.world.data.qpos[: ARM.dof] = self.hook.q
        self.world.check_now()
        self.task = Task(task.s_initial, task.s_target, 0.002, self.scene.prismatic)

    def lookahead(self, settings: PlanSettings, stage: Stage) -> Lookahead:
        return Lookahead(self.scene, stage, settings, self.task, self.hook, ARM.q_home, (0, 0), icem_sampler)

    def thinking(self, settings: PlanSettings, stage: Stage, count: int) -> tuple[float, float, int]:
        """CPU and wall time [s] and physics steps of so many control steps of sampling."""
        ahead = self.lookahead(settings, stage)
        substeps = round(settings.control_dt_s / stage.timestep_s)
        ahead.ranked(self.world.data, self.hook.q)
        before, cpu, wall = ahead.env_steps, time.process_time(), time.perf_counter()
        for _ in range(count):
            ahead.ranked(self.world.data, self.hook.q)
            ahead.sampler.forget()
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        return cpu, wall, (ahead.env_steps - before) * substeps

    def raw(self, settings: PlanSettings, stage: Stage, count: int) -> tuple[float, float, int]:
        """The same of the bare rollouts of so many control steps: the very calls of sampling, made once more."""
        ahead = self.lookahead(settings, stage)
        heard: Any = HeardBatch(ahead._rollouts._batch)
        ahead._rollouts._batch = heard
        ahead.ranked(self.world.data, self.hook.q)
        for _ in range(count):
            ahead.ranked(self.world.data, self.hook.q)
            ahead.sampler.forget()
        batch = mujoco.batch.Batch(
            self.scene.rollout_model(stage), nsim=heard.batch.nsim, nthread=settings.threads
        )
        qpos, qvel, warm = (batch.bind(name) for name in ("qpos", "qvel", "qacc_warmstart"))
        records: dict[int, Any] = {}
        cpu = wall = 0.0
        steps = 0
        for k, (nstep, control, spec, record, ids) in enumerate(heard.calls):
            qpos[:], qvel[:], warm[:] = self.world.data.qpos, self.world.data.qvel, 0.0
            began_cpu, began_wall = time.process_time(), time.perf_counter()
            records[len(ids)] = batch.rollout(
                nstep, control, spec, record, ids=ids, out=records.get(len(ids))
            )
            if k >= settings.icem.iterations:  # the first control step is not counted, as in sampling
                cpu += time.process_time() - began_cpu
                wall += time.perf_counter() - began_wall
                steps += len(ids) * nstep
        return cpu, wall, steps


class HeardBatch:
    """A batch that keeps what its rollouts were called with."""

    def __init__(self, batch: mujoco.batch.Batch) -> None:
        self.batch, self.calls = batch, []

    def rollout(self, nstep: int, control: np.ndarray, spec: int, record: Any, *, ids: Any, out: Any) -> Any:
        """As the batch does it."""
        self.calls.append((nstep, control.copy(), spec, record, ids))
        return self.batch.rollout(nstep, control, spec, record, ids=ids, out=out)


def share(bench: Bench, rounds: int, populations: tuple[int, ...]) -> list[dict]:
    """Physics steps per CPU second while sampling, over those of the same rollouts alone, by samples per iteration."""
    rows = []
    for population in populations:
        settings = PlanSettings(threads=1, icem=icem_of(population))
        stage = Stage(population=population)
        rates = {"plan": 0.0, "raw": 0.0}
        for _ in range(rounds):
            cpu, _, steps = bench.thinking(settings, stage, 10)
            rates["plan"] = max(rates["plan"], steps / cpu)
            cpu, _, steps = bench.raw(settings, stage, 10)
            rates["raw"] = max(rates["raw"], steps / cpu)
        rows.append(
            {
                "N": population,
                **{k: round(v) for k, v in rates.items()},
                "share": rates["plan"] / rates["raw"],
            }
        )
    return rows


def icem_of(population: int, horizon: int = 10) -> IcemSettings:
    return replace(IcemSettings(), population=population, elites=max(2, population // 6), horizon=horizon)


def threads(bench: Bench, rounds: int, populations: tuple[int, ...]) -> list[dict]:
    """Wall time of sampling with one and two threads, one after the other; the speed-up is the median over the pairs.

    What else runs slows either: over the best of each, one lucky round of one thread would decide. What the rollouts
    alone gain is what the machine gives; the difference is ours.
    """
    rows = []
    for population in populations:
        pairs = np.array([[_walls(bench, count, population) for count in (1, 2)] for _ in range(rounds)])
        one, two = pairs[:, 0], pairs[:, 1]
        gain = one / two
        rows.append(
            {
                "N": population,
                "wall of 10 control steps, 1 and 2 threads, best, ms": f"{1e3 * one[:, 0].min():.0f}, "
                f"{1e3 * two[:, 0].min():.0f}",
                "speed-up, median of pairs": float(np.median(gain[:, 0])),
                "quartiles": "{:.2f}, {:.2f}".format(*np.percentile(gain[:, 0], [25, 75])),
                "of the rollouts alone": float(np.median(gain[:, 1])),
            }
        )
    return rows


def _walls(bench: Bench, count: int, population: int) -> tuple[float, float]:
    """Wall time [s] of ten control steps of sampling on so many threads, and of the rollouts in them."""
    settings = PlanSettings(threads=count, icem=icem_of(population))
    ahead = bench.lookahead(settings, Stage(population=population))
    ahead.ranked(bench.world.data, bench.hook.q)
    batch: Any = TimedBatch(ahead._rollouts._batch)
    ahead._rollouts._batch = batch
    began_s = time.perf_counter()
    for _ in range(10):
        ahead.ranked(bench.world.data, bench.hook.q)
        ahead.sampler.forget()
    return time.perf_counter() - began_s, batch.wall_s


class TimedBatch:
    """A batch whose rollouts are timed; everything else is the batch's own."""

    def __init__(self, batch: mujoco.batch.Batch) -> None:
        self._batch, self.cpu_s, self.wall_s = batch, 0.0, 0.0

    def rollout(self, *given: Any, **named: Any) -> Any:
        """As the batch does it."""
        began_cpu_s, began_s = time.process_time(), time.perf_counter()
        record = self._batch.rollout(*given, **named)
        self.cpu_s += time.process_time() - began_cpu_s
        self.wall_s += time.perf_counter() - began_s
        return record


def serial(bench: Bench, rounds: int) -> list[dict]:
    """CPU of sampling outside of the rollouts, which no second thread shares; the round with the least."""
    best = (np.inf, np.inf)
    for _ in range(rounds):
        ahead = bench.lookahead(PlanSettings(threads=1), Stage())
        ahead.ranked(bench.world.data, bench.hook.q)
        batch: Any = TimedBatch(ahead._rollouts._batch)
        ahead._rollouts._batch = batch
        began_s = time.process_time()
        for _ in range(10):
            ahead.ranked(bench.world.data, bench.hook.q)
            ahead.sampler.forget()
        whole_s = time.process_time() - began_s
        best = min(best, (whole_s - batch.cpu_s, whole_s))
    alone = best[0] / best[1]
    return [
        {
            "CPU of 10 control steps, ms": round(1e3 * best[1], 1),
            "outside of the rollouts, ms": round(1e3 * best[0], 1),
            "share": alone,
            "speed-up by two perfect threads": 1.0 / (alone + (1.0 - alone) / 2.0),
        }
    ]


def identical(folder: Path) -> list[dict]:
    """Whether whole plans are the same number for number with one, two and three threads."""
    rows = []
    for name in ("drawer_open", "laptop_close", "faucet_left"):
        bench = Bench(folder, name)
        plans = [
            plan_manipulation(replace(bench.request, settings=PlanSettings(threads=count)))
            for count in (1, 2, 3)
        ]
        same = all(np.array_equal(plans[0].q_cmd, other.q_cmd) for other in plans[1:])
        rows.append({"task": name, "steps": plans[0].control_steps, "identical for 1, 2, 3 threads": same})
    return rows


def costs(bench: Bench, rounds: int) -> list[dict]:
    """CPU of one control step against samples and horizon."""
    rows = []
    for population, horizon in (
        (20, 10),
        (40, 10),
        (60, 10),
        (120, 10),
        (240, 10),
        (60, 5),
        (60, 20),
        (60, 40),
    ):
        settings = PlanSettings(threads=1, icem=icem_of(population, horizon))
        best = min(bench.thinking(settings, Stage(population=population), 4)[0] / 4 for _ in range(rounds))
        rows.append({"N": population, "h": horizon, "CPU of a control step, ms": round(1e3 * best, 1)})
    return rows


def pieces(folder: Path, rounds: int) -> list[dict]:
    """CPU of a control step, raw step rate and contacts against the number of convex pieces per box."""
    rows = []
    for count in (1, 2, 4, 8, 16):
        bench = Bench(folder, "drawer_open", pieces=count) if count > 1 else Bench(folder, "drawer_open")
        settings = PlanSettings(threads=1)
        best = min(bench.thinking(settings, Stage(), 4)[0] / 4 for _ in range(rounds))
        rate = max(n / c for c, _, n in (bench.raw(settings, Stage(), 10) for _ in range(rounds)))
        rows.append(
            {
                "pieces per box": count if count > 1 else "boxes",
                "geoms": bench.scene.fine.ngeom,
                "CPU of a control step, ms": round(1e3 * best, 1),
                "raw steps per CPU s": round(rate),
            }
        )
    return rows


def contacts(bench: Bench, rounds: int) -> list[dict]:
    """Raw rate with the fingertip behind the part, and with all contacts switched off."""
    rows = []
    for name, off in (("with contacts", False), ("contacts off", True)):
        stage, settings = Stage(), PlanSettings(threads=1)
        flags = bench.scene.coarse.opt.disableflags
        if off:
            bench.scene.coarse.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        rate = max(n / c for c, _, n in (bench.raw(settings, stage, 10) for _ in range(rounds)))
        bench.scene.coarse.opt.disableflags = flags
        rows.append({"model": name, "raw steps per CPU s": round(rate)})
    return rows


def table(title: str, rows: list[dict]) -> None:
    print(f"\n### {title}\n")
    print("| " + " | ".join(rows[0]) + " |\n|" + "---|" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="", help="share,threads,serial,identical,samples,pieces,contacts")
    parser.add_argument("--out", type=Path, help="also write the numbers as JSON here")
    options = parser.parse_args()
    known = ("share", "threads", "serial", "identical", "samples", "pieces", "contacts")
    if unknown := [part for part in options.only.split(",") if part and part not in known]:
        parser.error(f"--only names '{unknown[0]}'; parts are {', '.join(known)}")
    with tempfile.TemporaryDirectory() as name:
        folder, rounds = Path(name), options.rounds
        bench = Bench(folder, "drawer_open")
        parts = {
            "share": ("Share of raw throughput", lambda: share(bench, rounds, (20, 60, 150, 300))),
            "threads": ("Threads", lambda: threads(bench, rounds, (24, 60, 120, 300))),
            "serial": ("What stays on one thread", lambda: serial(bench, rounds)),
            "identical": ("Identical plans", lambda: identical(folder)),
            "samples": ("Samples and horizon", lambda: costs(bench, rounds)),
            "pieces": ("Convex pieces", lambda: pieces(folder, rounds)),
            "contacts": ("Contacts", lambda: contacts(bench, rounds)),
        }
        chosen = options.only.split(",") if options.only else list(parts)
        results = {parts[part][0]: parts[part][1]() for part in chosen}
    for title, rows in results.items():
        table(title, rows)
    if options.out:
        options.out.write_text(json.dumps(results, indent=1, default=str))


if __name__ == "__main__":
    main()
