"""Two drawers of one chest moved between the views: are both found, and how exactly? Prints a table.

    python tests/bench/bench_perception_several.py --split test --count 20 --out runs/perception-several

Chests of two and more fronts (s2r_sim.objects.chest) seen through the stand-in's active-stereo camera. The drawer that
has a joint and one of its neighbours, whose front and handle are moved as a body, go 3 to 10 cm each, in or out. Pairs
whose motions differ by less than 1.5 cm are listed apart: rigid parts that move alike are one part to a depth camera.
Results are kept as JSON lines; an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from s2r_host.perception import AbstainError, DepthFrame, estimate_joints
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.catalogue import kind_named
from s2r_sim.objects.chest import ChestSpec
from s2r_sim.objects.naming import BASE_BODY
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.scene import joint_truth, qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng

UNLIKE_M = 0.015


def measure(split: int, seed: int) -> dict[str, Any]:
    """Draw one chest, move two drawers, judge the answers."""
    rng = split_rng("chest", Split(split), seed)
    spec: ChestSpec = kind_named("chest").draw(rng)
    cells = [
        (r, c) for r in range(spec.rows) for c in range(spec.columns) if (r, c) != (spec.row, spec.column)
    ]
    if not cells:
        return {"seed": seed, "fronts": 1}
    row, column = cells[int(rng.integers(len(cells)))]
    way = rng.uniform(0.03, 0.10, 2) * rng.choice([-1, 1], 2)
    start = np.maximum(0.01, 0.01 - way) + rng.uniform(0, 0.05, 2)
    spec = spec.model_copy(update={"q_start": round(float(start[0]), 6)})
    before = _with_front(spec, f"base_{row}_{column}_", start[1])
    after = _with_front(spec, f"base_{row}_{column}_", start[1] + way[1])
    truth = place_camera(rng, before, spec.q_start)[0]
    cameras = DepthCamera(before, truth), DepthCamera(after, truth)
    frames = [
        DepthFrame(camera.capture(qpos_at(model, q)).depth_m, camera.rig.K, camera.X_base_camera, None)
        for camera, model, q in zip(
            cameras, (before, after), (spec.q_start, spec.q_start + way[0]), strict=True
        )
    ]
    axes = [np.array(joint_truth(before, spec).direction), _forward(before)]
    result: dict[str, Any] = {"seed": seed, "fronts": 1 + len(cells), "way_mm": (1e3 * way).tolist()}
    clock = time.process_time()
    try:
        found = estimate_joints(frames[0], frames[1])
    except AbstainError as error:
        return result | {"abstained": str(error), "cpu_s": time.process_time() - clock}
    result |= {"cpu_s": time.process_time() - clock, "types": [one.joint_type for one in found]}
    # Every true motion takes the answer whose displacement is nearest.
    moved = np.array([one.delta * one.axis_direction for one in found])
    errors = []
    for axis, d in zip(axes, way, strict=True):
        k = int(np.linalg.norm(moved - d * axis, axis=1).argmin())
        cosine = float(np.clip(found[k].axis_direction @ (np.sign(d) * axis), -1, 1))
        errors.append([k, float(np.degrees(np.arccos(cosine))), 1e3 * (found[k].delta - abs(float(d)))])
    return result | {"errors": errors}


def _with_front(spec: ChestSpec, name: str, opened_m: float) -> mujoco.MjModel:
    """The chest with the front and handle of a second drawer pulled out."""
    model = table_scene(spec).compile()
    for geom in range(model.ngeom):
        if model.geom(geom).name.startswith(name):
            model.geom_pos[geom, 0] += opened_m
    return model


def _forward(model: mujoco.MjModel) -> np.ndarray:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data.xmat[model.body(BASE_BODY).id].reshape(3, 3)[:, 0].copy()


def print_table(rows: list[dict[str, Any]]) -> None:
    """Pairs with clearly unlike motions, and the others."""
    rows = [row for row in rows if row["fronts"] > 1]
    print("| motions | pairs | abstained | both found, both slides | axis [°] | way [mm] | CPU [s] |")
    print("|---|---|---|---|---|---|---|")
    for name, alike in (("unlike", False), ("alike", True)):
        mine = [row for row in rows if (abs(np.diff(row["way_mm"])[0]) < 1e3 * UNLIKE_M) == alike]
        if not mine:
            continue
        answered = [row for row in mine if "errors" in row]
        both = [row for row in answered if len({e[0] for e in row["errors"]}) == 2]
        both = [row for row in both if row["types"] == ["prismatic"] * 2]
        errors = np.array([e[1:] for row in both for e in row["errors"]]).reshape(-1, 2)
        spread = [
            f"{np.percentile(v, 50):.2f} / {np.percentile(v, 90):.2f}" if len(v) else "–"
            for v in (errors[:, 0], np.abs(errors[:, 1]))
        ]
        cpu = np.median([row["cpu_s"] for row in mine])
        counts = f"{len(mine)} | {len(mine) - len(answered)} | {len(both)}"
        print(f"| {name} | {counts} | {spread[0]} | {spread[1]} | {cpu:.1f} |")


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--split", default="validation", choices=[s.name.lower() for s in Split])
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=20, help="chests drawn; those of one front do not count")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    args = parser.parse_args()
    jobs = [(int(Split[args.split.upper()]), seed) for seed in range(args.first, args.first + args.count)]
    print_table(run_jobs(measure, jobs, args.out / "rows.jsonl", args.jobs, "chests"))


if __name__ == "__main__":
    main()
