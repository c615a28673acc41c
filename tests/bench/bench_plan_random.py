"""`s2r plan` on random furniture and fittings: `python tests/bench/bench_plan_random.py --count 60 --out DIR`.

Scene N is drawn from seed N (random_fittings.py): sizes, place and turn before the arm, handle, mass, friction, damping
and the task are random, whether a plan exists is not looked at. So some tasks are impossible and are rightly refused;
the table says why. The scenes and plans are left in DIR, what is done is in DIR/results.jsonl and is not done again,
and the verifier steps every plan again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from bench_plan_scenes import carried_out, kept, line
from random_fittings import FAMILIES, scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--limit", type=float, default=120.0, help="seconds per plan")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    results = chosen.out / "results.jsonl"
    known = {row["seed"]: row for row in kept(parser, results, {"--limit": chosen.limit})}
    seeds = range(chosen.first, chosen.first + chosen.count)
    for seed in seeds:
        if seed not in known:
            text, family, target = scene(seed)
            file = chosen.out / f"{family}_{seed:04d}.xml"
            file.write_text(text)
            known[seed] = {
                "seed": seed,
                "family": family,
                **carried_out(file, "part", target, chosen.out, chosen.limit),
            }
            with results.open("a") as stream:
                stream.write(json.dumps(known[seed]) + "\n")
        print(line(known[seed]), flush=True)
    print(summary([known[seed] for seed in seeds]))


def summary(rows: list[dict[str, Any]]) -> str:
    """A line per family and one for all: planned, verified, fragile, processor time."""
    lines = [
        "",
        "| family | scenes | planned | verified | fragile | CPU p50, worst, s |",
        "|---|---|---|---|---|---|",
    ]
    for name in (*(family.__name__ for family in FAMILIES), "all"):
        drawn = [row for row in rows if name in ("all", row["family"])]
        done = [row for row in drawn if row["planned"]]
        if not drawn:
            continue
        cpu = (
            f"{np.median([row['cpu_s'] for row in done]):.1f}, {max(row['cpu_s'] for row in done):.1f}"
            if done
            else "–"
        )
        verified, fragile = sum(row["verified"] for row in done), sum(bool(row["fragile"]) for row in done)
        lines.append(f"| {name} | {len(drawn)} | {len(done)} | {verified} | {fragile} | {cpu} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
