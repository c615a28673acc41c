"""Ablation: the joint without interactive perception. From the first view of each pair alone the push network guesses
part, type and axis; `bench_perception.py` measures the same pairs from both views.

    python tests/bench/bench_perception_one_view.py --split test --first 100 --count 100 --out runs/perception-one-view

A guess has no sense, so angles are between lines (0 to 90 degrees), which flatters it against the measured axes, and no
joint value. Results are kept as JSON lines; an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.perception import AbstainError
from s2r_host.perception.affordance import WEIGHTS, PushNetworkRuntime
from s2r_host.perception.motion import line_distance
from s2r_host.perception.single_view import guess_joint
from s2r_sim.batch import run_jobs
from s2r_sim.objects.pairs import draw_pair
from s2r_sim.objects.splits import Split

sys.path.insert(0, str(Path(__file__).parent))
from bench_perception import CATEGORIES, frames, true_motion


@lru_cache(maxsize=1)
def runtime(folder: str) -> PushNetworkRuntime:
    """The network, loaded once per process."""
    return PushNetworkRuntime(Path(folder))


def measure(kind: str, split: int, seed: int, weights: str) -> dict[str, Any]:
    """Guess the joint of one object from its first view."""
    pair = draw_pair(kind, Split(split), seed)
    truth = true_motion(pair)
    belief = runtime(weights).affordance(frames(pair)[0], np.random.default_rng(seed))
    part = pair.part_before.ravel()[belief.cloud.pixels]
    believed = belief.part > 0.5
    overlap = float((part & believed).sum() / max((part | believed).sum(), 1))
    row: dict[str, Any] = {"kind": kind, "seed": seed, "type_true": truth.joint_type, "overlap": overlap}
    try:
        found = guess_joint(belief)
    except AbstainError as error:
        return row | {"abstained": str(error)}
    cosine = min(1.0, abs(float(found.direction @ truth.direction)))
    middle = (pair.part_points.min(axis=0) + pair.part_points.max(axis=0)) / 2
    foot = truth.origin + ((middle - truth.origin) @ truth.direction) * truth.direction
    return row | {
        "type": found.joint_type,
        "axis_deg": float(np.degrees(np.arccos(cosine))),
        "line_mm": 1e3 * float(line_distance(found.origin, found.direction, foot[None])[0]),
    }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="chest,laptop,faucet", help="comma-separated")
    parser.add_argument("--split", default="validation", choices=[s.name.lower() for s in Split])
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=30, help="pairs per kind")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="folder of the trained network")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    args = parser.parse_args()
    split, kinds = int(Split[args.split.upper()]), args.kinds.split(",")
    seeds = range(args.first, args.first + args.count)
    jobs = [(kind, split, seed, str(args.weights)) for seed in seeds for kind in kinds]
    rows = run_jobs(measure, jobs, args.out / "rows.jsonl", args.jobs, "views")
    print(
        "| category | n | abstained | part overlap | type right | axis [°] | line [mm] |\n|---|---|---|---|---|---|---|"
    )
    for kind in kinds:
        mine = [row for row in rows if row["kind"] == kind]
        answered = [row for row in mine if "type" in row]
        good = [row for row in answered if row["type"] == row["type_true"]]
        axis, line = (_spread([row[name] for row in good]) for name in ("axis_deg", "line_mm"))
        overlap = float(np.median([row["overlap"] for row in mine]))
        counts = f"{len(mine)} | {len(mine) - len(answered)} | {overlap:.2f} | {len(good)}/{len(answered)}"
        turns = mine[0]["type_true"] == "revolute"
        print(f"| {CATEGORIES[kind]} | {counts} | {axis} | {line if turns else '–'} |")


def _spread(values: list[float]) -> str:
    return f"{np.percentile(values, 50):.1f} / {np.percentile(values, 90):.1f}" if values else "–"


if __name__ == "__main__":
    main()
