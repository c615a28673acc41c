"""Does the pair network know the side of a part that nobody saw better than a thickness prior does?

    python tests/bench/bench_pair_space.py --split test --first 720 --count 20 --weights runs/model --out runs/space

On pairs that geometry answers. Thickness: from points of the part's faces in the first view straight inwards, to where
the network's occupancy falls below one half, against the exact solid and against the thickness that the model builder
assumes (8 mm for plates as lids are, 18 mm for fronts, 20 mm for levers). Overlap: intersection over union on points of
space around the part that neither view saw to be empty, of the occupancy and of the seen faces grown inwards by that
thickness. Rows are kept as JSON lines; an interrupted run goes on.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench_perception import frames, runtime, weights_hash
from refusals import told_by
from scipy.spatial import cKDTree

from s2r_host.learn.solids import drawn_around, inside
from s2r_host.perception import AbstainError, BadViewError, estimate_joint
from s2r_host.perception.estimate import prepare
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.pair_cloud import pool
from s2r_host.perception.pair_network import PairNetworkRuntime
from s2r_host.perception.segment import segment
from s2r_host.perception.view import Seen
from s2r_sim.batch import run_jobs
from s2r_sim.objects.pair_data import part_solids
from s2r_sim.objects.pairs import draw_pair
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split

PRIOR_M = {"chest": 0.018, "laptop": 0.008, "faucet": 0.020}
DEEPEST_M, STEP_M = 0.04, 0.001
RAYS, QUERIES, AROUND_M, BESIDE_M = 150, 1500, 0.02, 0.01


def measure(weights: str, kind: str, split: int, seed: int) -> dict[str, Any]:
    """Both on one pair; without numbers where geometry abstains."""
    pair, rng = draw_pair(kind, Split(split), seed), np.random.default_rng([seed, 6])
    row: dict[str, Any] = {"kind": kind, "seed": seed}
    try:
        found = estimate_joint(*frames(pair))
        scene, _ = prepare(*frames(pair), None, None, None, rng)
    except (AbstainError, BadViewError) as error:
        return row | {"abstained": str(error)}
    return row | compare(scene, found.motion, exact_solids(pair.spec), PRIOR_M[kind], runtime(weights), rng)


def exact_solids(spec: Any) -> np.ndarray:
    """The part in the first view, rows as in `s2r_sim.objects.pair_data`."""
    model = table_scene(spec).compile()
    opening = getattr(spec, "opening_m", None)
    return part_solids(model, qpos_at(model, spec.q_start if opening is None else opening))


def compare(
    scene: Scene,
    motion: JointMotion,
    solids: np.ndarray,
    prior_m: float,
    network: PairNetworkRuntime,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Median thicknesses [mm] and overlaps."""
    view, parts = scene.before, segment(scene, motion)
    pools = pool(scene, rng)
    face = np.flatnonzero(parts.before & view.normal_ok & ~view.edge)
    p, n = view.points[face], view.normals[face]
    at = rng.permutation(len(face))[:RAYS]
    depth = np.arange(STEP_M, DEEPEST_M, STEP_M)
    inwards = (p[at, None] - depth[None, :, None] * n[at, None]).reshape(-1, 3)
    true = _run(inside(inwards, solids).reshape(len(at), -1))
    told = _run(network.space(pools, motion, inwards, rng).reshape(len(at), -1) > 0.5)
    good = true > 0  # a ray that begins outside the solid, at a smeared edge, says nothing
    query, X = drawn_around(solids, 4 * QUERIES, AROUND_M, rng), motion.transform()
    free = view.look(query, 0.001).seen == Seen.FREE
    free |= scene.after.look(query @ X[:3, :3].T + X[:3, 3], 0.001).seen == Seen.FREE
    query = query[~free][:QUERIES]
    full = inside(query, solids)
    near, index = cKDTree(p).query(query)
    behind = np.einsum("ni,ni->n", p[index] - query, n[index])
    aside = np.sqrt(np.maximum(near**2 - behind**2, 0.0))
    grown = (behind > 0) & (behind < prior_m) & (aside < BESIDE_M)
    occupied = network.space(pools, motion, query, rng) > 0.5
    return {
        "thick_true_mm": 1e3 * STEP_M * float(np.median(true[good])) if good.any() else None,
        "thick_network_mm": 1e3 * STEP_M * float(np.median(told[good])) if good.any() else None,
        "thick_prior_mm": 1e3 * prior_m,
        "overlap_network": _overlap(occupied, full),
        "overlap_prior": _overlap(grown, full),
    }


def _run(filled: np.ndarray) -> np.ndarray:
    """How many steps from the surface on are filled without a gap; the first two may be empty (noise), (rays,)."""
    filled = filled.copy()
    filled[:, :2] |= filled[:, 2:3]
    return np.cumprod(filled, axis=1).sum(axis=1)


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


def print_table(rows: list[dict[str, Any]]) -> None:
    """Medians per kind."""
    print(
        "| kind | pairs | thickness, truth [mm] | error, network [mm] | error, prior [mm] | IoU, network | IoU, prior |"
    )
    print("|---|---|---|---|---|---|---|")
    for kind in dict.fromkeys(row["kind"] for row in rows):
        good = [row for row in rows if row["kind"] == kind and row.get("thick_true_mm") is not None]
        if not good:
            continue
        true, told, prior, a, b = (
            np.array([row[name] for row in good])
            for name in (
                "thick_true_mm",
                "thick_network_mm",
                "thick_prior_mm",
                "overlap_network",
                "overlap_prior",
            )
        )
        print(
            f"| {kind} | {len(good)} | {np.median(true):.0f} | {np.median(np.abs(told - true)):.1f} |"
            f" {np.median(np.abs(prior - true)):.1f} | {np.median(a):.2f} | {np.median(b):.2f} |"
        )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="chest,laptop,faucet", help="comma-separated")
    parser.add_argument("--split", default="validation", choices=[s.name.lower() for s in Split])
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=10, help="pairs per kind")
    parser.add_argument("--weights", type=Path, required=True, help="folder of a trained pair network")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows")
    args = parser.parse_args()
    split, seeds = int(Split[args.split.upper()]), range(args.first, args.first + args.count)
    jobs = [(kind, split, seed) for seed in seeds for kind in args.kinds.split(",")]
    work, conditions = partial(measure, str(args.weights)), {"--weights": weights_hash(args.weights)}
    with told_by(parser):
        rows = run_jobs(work, jobs, args.out / "rows.jsonl", args.jobs, "pairs", conditions=conditions)
    print_table(rows)


if __name__ == "__main__":
    main()
