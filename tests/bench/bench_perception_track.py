"""How well and how fast is a joint followed from depth frames? Prints a markdown table; no budget is asserted.

    python tests/bench/bench_perception_track.py --first 1300 --count 34 --out runs/track

Per object: the joint is estimated from one noisy pair of the test split, then the part moves on from the second view in
even steps to the farther end of its range, seen by the same camera; every frame is new noise. Times are CPU time of one
thread per frame of 848x480, without the camera. Objects of the kinds take turns and each is written to ``--out`` when
it is done, so that a run that is ended early is a smaller one.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.perception import AbstainError, DepthFrame, estimate_joint
from s2r_host.perception.track import JointTracker
from s2r_sim.objects.catalogue import KINDS
from s2r_sim.objects.pairs import camera_of, draw_pair
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split

FRAMES = 10


def follow(kind: str, seed: int) -> list[dict[str, Any]] | None:
    """One row per frame; None if no joint was found to follow."""
    pair = draw_pair(kind, Split.TEST, seed)
    before, after = (
        DepthFrame(d, pair.K, pair.X_base_camera, None) for d in (pair.depth_before, pair.depth_after)
    )
    try:
        estimate = estimate_joint(before, after)
    except AbstainError:
        return None
    sense = np.sign(pair.delta)
    model = table_scene(pair.spec).compile()
    camera = camera_of(pair, model)
    seen = pair.joint.q_start + pair.delta
    end = 0.0 if 2 * seen > pair.joint.q_max else pair.joint.q_max
    path = np.linspace(seen, end, FRAMES)
    tracker = JointTracker.of(estimate)
    rows = []
    for q in path:
        frame = DepthFrame(camera.capture(qpos_at(model, float(q))).depth_m, pair.K, pair.X_base_camera, None)
        start = time.thread_time()
        state = tracker.update(frame)
        rows.append(
            {
                "ms": 1e3 * (time.thread_time() - start),
                "error": None if state.value is None else state.value - sense * (q - pair.joint.q_start),
                "half": None if state.interval90 is None else (state.interval90[1] - state.interval90[0]) / 2,
            }
        )
    return rows


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="drawer,laptop,faucet", help="comma-separated")
    parser.add_argument("--first", type=int, default=500, help="first number of the test split")
    parser.add_argument("--count", type=int, default=5, help="objects per kind")
    parser.add_argument("--out", type=Path, help="folder for a line per object, track.jsonl")
    args = parser.parse_args()
    kinds, followed = args.kinds.split(","), []
    for seed in range(args.first, args.first + args.count):
        for kind in kinds:
            followed.append({"kind": kind, "seed": seed, "rows": follow(kind, seed)})
            if args.out is not None:
                args.out.mkdir(parents=True, exist_ok=True)
                with (args.out / "track.jsonl").open("a") as file:
                    file.write(json.dumps(followed[-1]) + "\n")
    report(kinds, followed)


def report(kinds: list[str], followed: list[dict[str, Any]]) -> None:
    """Print the table; *far off* are frames whose error is more than three times what the interval allows."""
    print(
        "| kind | objects | not estimated | frames | lost | error p50 / p90 / worst | in 90 % | far off |"
        " CPU p50 / p99 / worst [ms] |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for kind in kinds:
        of_kind = [entry["rows"] for entry in followed if entry["kind"] == kind]
        rows = [row for sequence in of_kind if sequence is not None for row in sequence]
        found = [row for row in rows if row["error"] is not None]
        scale, unit = (1e3, "mm") if KINDS[kind].slides else (180 / np.pi, "°")
        error = scale * np.abs([row["error"] for row in found]) if found else np.full(1, np.nan)
        ratio = np.array([abs(row["error"]) / row["half"] for row in found])
        ms = [row["ms"] for row in rows] or [float("nan")]
        print(
            f"| {kind} | {len(of_kind)} | {sum(rows is None for rows in of_kind)} | {len(rows)} |"
            f" {len(rows) - len(found)} |"
            f" {np.percentile(error, 50):.2f} / {np.percentile(error, 90):.2f} / {error.max():.2f} {unit} |"
            f" {100 * np.mean(ratio < 1):.0f} % | {int((ratio > 3).sum())} |"
            f" {np.median(ms):.1f} / {np.percentile(ms, 99):.1f} / {max(ms):.1f} |"
        )


if __name__ == "__main__":
    main()
