"""How long do two clouds take to a model that loads? Prints a markdown table; no budget is asserted.

    python tests/bench/bench_build_time.py --count 10 --out runs/build-time

Views of procedural objects are written as files; then `s2r build-model` is called on them as a user does, with its
start, both pictures and the pair network. CPU is that of the command and of everything it starts (CoACD runs in child
processes); wall is what a clock on the wall says, which other work on the machine makes longer. Loads: MuJoCo takes the
MJCF, Pinocchio the URDF. Networks: the inference alone, on the same views and on one thread, the weights loaded before;
"pair" is what the command asks, "push" is what `s2r run` asks before its first push. Times of models that came out;
where the views tell no joint there is no model, and these are counted as abstained with their CPU apart. Results are
kept as JSON lines; a run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio
from bench_perception import frames
from refusals import told_by

from s2r_host.perception import AbstainError, BadViewError, DepthFrame
from s2r_host.perception.affordance import PushNetworkRuntime
from s2r_host.perception.estimate import prepare
from s2r_host.perception.object_cloud import object_cloud
from s2r_host.perception.pair_network import PairNetworkRuntime
from s2r_protocol.exits import ExitCode
from s2r_sim.batch import run_jobs
from s2r_sim.objects.pairs import draw_pair
from s2r_sim.objects.splits import Split

NETWORKS = {"pair": PairNetworkRuntime, "push": PushNetworkRuntime}
GOAL_S, NETWORK_GOAL_S = 20.0, 1.0


def measure(out: str, kind: str, split: int, seed: int) -> dict[str, Any]:
    """Write two views, build the model from the files, load it, and ask both networks."""
    pair = draw_pair(kind, Split(split), seed)
    folder = Path(out) / f"{kind}-{seed:05d}"
    folder.mkdir(parents=True, exist_ok=True)
    before, after = folder / "before.npz", folder / "after.npz"
    for file, depth, colour in (
        (before, pair.depth_before, pair.colour_before),
        (after, pair.depth_after, pair.colour_after),
    ):
        np.savez_compressed(file, depth=depth, K=pair.K, T_base_camera=pair.X_base_camera, colour=colour)
    row = {"kind": kind, "seed": seed} | command(before, after, folder / "model")
    return row | inference(*frames(pair))


def command(before: Path, after: Path, out: Path) -> dict[str, Any]:
    """Call `s2r build-model` on two files: exit code, CPU and wall time, and whether what it wrote loads.

    Raises:
        RuntimeError: It ended otherwise than with a model or without an answer.
    """
    asked = [sys.executable, "-m", "s2r_protocol", "build-model", "--json"]
    asked += ["--before", str(before), "--after", str(after), "--out", str(out)]
    start, cpu_before = time.perf_counter(), children_cpu_s()
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    row = {
        "exit_code": done.returncode,
        "wall_s": time.perf_counter() - start,
        "cpu_s": children_cpu_s() - cpu_before,
    }
    if done.returncode == ExitCode.REFUSED:
        return row | {"reason": json.loads(done.stdout)["reason"]}
    if done.returncode:
        raise RuntimeError(f"{' '.join(asked)} ended with exit code {done.returncode}: {done.stderr.strip()}")
    return row | {"loads": loads(out)}


def children_cpu_s() -> float:
    """Processor time [s] of the processes that this one started, theirs included, as far as they have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def loads(folder: Path) -> bool:
    """Whether both files of a model are taken, with the one joint they should have."""
    try:
        joints = [
            mujoco.MjModel.from_xml_path(str(folder / "object.xml")).njnt,
            pinocchio.buildModelFromUrdf(str(folder / "object.urdf")).nv,
        ]
    except ValueError:
        return False
    return joints == [1, 1]


def inference(before: DepthFrame, after: DepthFrame) -> dict[str, Any]:
    """CPU time [s] of each network's answer alone; None where there is nothing to ask it."""
    scene, _ = attempt(lambda: prepare(before, after, None, None, None, np.random.default_rng(0))) or (
        None,
        [],
    )
    cloud = attempt(lambda: object_cloud(before, np.random.default_rng(0)))
    pair, push = network("pair"), network("push")
    return {
        "pair_s": None if scene is None else cpu_s_of(lambda: pair.belief(scene, np.random.default_rng(0))),
        "push_s": None if cloud is None else cpu_s_of(lambda: push.judge(cloud, np.random.default_rng(0))),
    }


def cpu_s_of(work: Callable[[], object]) -> float:
    """Processor time [s] of this process for some work."""
    start = time.process_time()
    work()
    return time.process_time() - start


def attempt(look: Callable[[], Any]) -> Any:
    """What a look at views gives, None where they are refused."""
    try:
        return look()
    except (AbstainError, BadViewError):
        return None


@cache
def network(name: str) -> Any:
    """The shipped network of this name, loaded once per process."""
    return NETWORKS[name]()


def spread(values: list[float]) -> str:
    """Median / 90th percentile / worst."""
    if not values:
        return "–"
    return f"{np.median(values):.1f} / {np.percentile(values, 90):.1f} / {max(values):.1f}"


def print_table(rows: list[dict[str, Any]]) -> None:
    """A line per kind and one for all; median / 90th percentile / worst."""
    head = (
        "kind", "objects", "models that load", "abstained", "CPU [s]", f"within {GOAL_S:.0f} s", "wall [s]",
        "CPU of an abstention [s]", "pair network [s]", "push network [s]",
    )  # fmt: skip
    print(f"| {' | '.join(head)} |")
    print("|---" * len(head) + "|")
    kinds = dict.fromkeys(row["kind"] for row in rows)
    for name, mine in [
        *((kind, [row for row in rows if row["kind"] == kind]) for kind in kinds),
        ("all", rows),
    ]:
        built, abstained = [row for row in mine if "loads" in row], [row for row in mine if "reason" in row]
        cells = [
            name,
            str(len(mine)),
            f"{sum(row['loads'] for row in built)} of {len(built)}",
            str(len(abstained)),
            spread([row["cpu_s"] for row in built]),
            f"{sum(row['cpu_s'] <= GOAL_S for row in built)} of {len(built)}",
            spread([row["wall_s"] for row in built]),
            spread([row["cpu_s"] for row in abstained]),
            *(spread([row[f"{net}_s"] for row in mine if row[f"{net}_s"] is not None]) for net in NETWORKS),
        ]
        print(f"| {' | '.join(cells)} |")


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="drawer,chest,laptop,faucet", help="comma-separated")
    parser.add_argument("--split", default="test", choices=[s.name.lower() for s in Split])
    parser.add_argument("--first", type=int, default=5500, help="first seed")
    parser.add_argument("--count", type=int, default=100, help="objects per kind")
    parser.add_argument("--out", type=Path, required=True, help="folder of the views, models and results")
    args = parser.parse_args()
    split = int(Split[args.split.upper()])
    seeds = range(args.first, args.first + args.count)
    jobs = [(str(args.out), kind, split, seed) for seed in seeds for kind in args.kinds.split(",")]
    with told_by(parser):
        # One after the other: what ran beside it would be in the times.
        rows = run_jobs(measure, jobs, args.out / "rows.jsonl", 1, "models")
    print_table(rows)


if __name__ == "__main__":
    main()
