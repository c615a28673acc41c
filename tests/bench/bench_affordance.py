"""Does the first push move the part? The push network against random pushes and a rule, on the same unseen
objects.

    s2r data pushes --split train --objects 40 --out runs/pushes
    s2r data pushes --split validation --objects 5 --out runs/pushes
    s2r train affordance --data runs/pushes --out runs/affordance --epochs 40  # shipped: stopped after 24
    python tests/bench/bench_affordance.py --count 20 --out runs/affordance-test

Every method gets the same noisy view and one push of 8 cm with a flying fingertip: the first of its proposals
whose start is free, out of 20. A push counts when the part moves 3 cm or 15 degrees. Random: any point of the
object, any direction within 70 degrees of straight in. Rule: the points that stand out furthest towards the
camera, pushed straight in, those in the middle first. Intervals are Wilson's, 95 %. Results are kept as JSON
lines; an interrupted run goes on.
"""

from __future__ import annotations

import argparse
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.perception.affordance import WEIGHTS, PushNetworkRuntime
from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.object_cloud import ObjectCloud, object_cloud
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.catalogue import KINDS
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.push_data import with_room
from s2r_sim.objects.pushes import PushScene, useful
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng

CONE_RAD = np.deg2rad(70)
STANDING_OUT = 0.98
TRIES = 20
METHODS = ("random", "rule", "network")


@lru_cache(maxsize=1)
def runtime(folder: str) -> PushNetworkRuntime:
    """The network, loaded once per process."""
    return PushNetworkRuntime(Path(folder))


def first_pushes(kind: str, seed: int, weights: str) -> dict[str, Any]:
    """One object: what each method's first push does."""
    rng = split_rng(kind, Split.TEST, seed)
    spec = with_room(rng, KINDS[kind].draw(rng))
    model = table_scene(spec).compile()
    camera = DepthCamera(model, place_camera(rng, model, spec.q_start)[0])
    depth = camera.capture(qpos_at(model, spec.q_start)).depth_m
    frame = DepthFrame(depth, camera.rig.K, camera.X_base_camera, None)
    try:
        cloud = object_cloud(frame, rng)
    except BadViewError:
        return {"kind": kind, "seed": seed, "out_of_sight": True}
    proposals = runtime(weights).judge(cloud, rng).proposals
    pushes = {
        "random": [random_push(cloud, rng) for _ in range(TRIES)],
        "rule": ruled_pushes(cloud, camera.X_base_camera),
        "network": [(p.point, p.direction) for p in proposals[:TRIES]],
    }
    scene = PushScene(spec)
    row: dict[str, Any] = {"kind": kind, "seed": seed, "likelihood": proposals[0].likelihood}
    for method, candidates in pushes.items():
        results = (scene.push(point, direction) for point, direction in candidates)
        tried, result = next(((k, r) for k, r in enumerate(results) if not r.blocked), (TRIES, None))
        delta = 0.0 if result is None else result.delta
        row[method] = {"delta": delta, "blocked": tried, "useful": useful(kind, delta)}
    return row


def random_push(cloud: ObjectCloud, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Any visible point, any direction into the surface."""
    i = int(rng.integers(len(cloud.points)))
    inward = -cloud.normals[i]
    across = np.cross(inward, rng.normal(size=3))
    across /= np.linalg.norm(across)
    angle = np.arccos(rng.uniform(np.cos(CONE_RAD), 1.0))
    return cloud.points[i], np.cos(angle) * inward + np.sin(angle) * across


def ruled_pushes(cloud: ObjectCloud, X_base_camera: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points of what stands out furthest towards the camera, from the middle outwards, pushed along their normals."""
    towards = X_base_camera[:3, 3] - cloud.centre
    towards = np.array([towards[0], towards[1], 0.0]) / np.linalg.norm(towards[:2])
    out = cloud.points @ towards
    front = np.flatnonzero(out >= np.quantile(out, STANDING_OUT))
    middle = cloud.points[front].mean(axis=0)
    order = front[np.argsort(np.linalg.norm(cloud.points[front] - middle, axis=1))]
    return [(cloud.points[i], -cloud.normals[i]) for i in order[:TRIES]]


def wilson95(hits: int, count: int) -> str:
    """Share with its Wilson interval (Wilson 1927), in per cent."""
    z, share = 1.96, hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(share * (1 - share) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    return f"{100 * share:.0f} % ({100 * max(middle - half, 0):.0f} to {100 * min(middle + half, 1):.0f})"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="drawer,chest,laptop,faucet,door,lid,dial", help="comma-separated")
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument("--count", type=int, default=20, help="objects per kind")
    parser.add_argument(
        "--weights",
        type=Path,
        default=WEIGHTS,
        help="folder of the trained network [default: the shipped one]",
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    args = parser.parse_args()
    kinds = args.kinds.split(",")
    seeds = range(args.first, args.first + args.count)
    jobs = [(kind, seed, str(args.weights)) for seed in seeds for kind in kinds]
    rows = run_jobs(first_pushes, jobs, args.out / "rows.jsonl", args.jobs, "first pushes")
    print(f"| kind | objects | out of sight | {' | '.join(METHODS)} |\n|---|---|---|---|---|---|")
    for kind in [*kinds, "all"]:
        mine = [row for row in rows if kind in (row["kind"], "all")]
        seen = [row for row in mine if "network" in row]
        cells = [wilson95(sum(row[m]["useful"] for row in seen), len(seen)) if seen else "–" for m in METHODS]
        print(f"| {kind} | {len(mine)} | {len(mine) - len(seen)} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
