"""Two drawers of one chest moved between the views: are both found, and how exactly? Prints tables.

    python tests/bench/bench_perception_several.py --split test --count 40 --out runs/perception-several

Chests of two and more drawers (s2r_sim.objects.chest) seen through the stand-in's active-stereo camera. Two of the
drawers go 3 to 10 cm each, in or out. Pairs whose motions differ by less than 1.5 cm are listed apart: rigid parts that
move alike are one part to a depth camera. So are pairs of which one drawer is hardly in sight in one of the views, as
below another one that stands open. A drawer is right with its axis within 2 degrees and its way within 2 mm. The
second table is a control: of the same chests one drawer alone has moved, and one part is to be found.
Results are kept as JSON lines; an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.perception import AbstainError, DepthFrame, estimate_joints
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.catalogue import kind_named
from s2r_sim.objects.chest import ChestSpec
from s2r_sim.objects.naming import PART_BODY, other_part
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.scene import joint_truth, qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng

UNLIKE_M = 0.015
SEEN_PX = 400  # of either drawer in either view, of 848 x 480
RIGHT_DEG, RIGHT_MM = 2.0, 2.0


def measure(split: int, seed: int) -> dict[str, Any]:
    """Draw one chest, move two drawers and one, judge the answers."""
    rng = split_rng("chest", Split(split), seed)
    spec: ChestSpec = kind_named("chest").draw(rng)
    if not spec.places:
        return {"seed": seed, "drawers": 1}
    second = spec.places[int(rng.integers(len(spec.places)))]
    way = rng.uniform(0.03, 0.10, 2) * rng.choice([-1, 1], 2)
    start = np.maximum(0.01, 0.01 - way) + rng.uniform(0, 0.05, 2)
    spec = spec.model_copy(update={"q_start": float(start[0]), "others": (0.0,) * len(spec.places)})
    model = table_scene(spec).compile()
    body, joint = other_part(f"{second[0]}_{second[1]}")
    bodies = model.body(PART_BODY).id, model.body(body).id

    def found_at(first: float, other: float) -> np.ndarray:
        qpos = qpos_at(model, first)
        qpos[model.joint(joint).qposadr[0]] = other
        return qpos

    camera = DepthCamera(model, place_camera(rng, model, spec.q_start)[0])
    states = found_at(*start), found_at(*(start + way)), found_at(start[0] + way[0], start[1])
    frames = [
        DepthFrame(camera.capture(qpos).depth_m, camera.rig.K, camera.X_base_camera, None) for qpos in states
    ]
    seen = [camera.exact_sight(qpos).body for qpos in states[:2]]
    axis = np.array(joint_truth(model, spec).direction)
    result: dict[str, Any] = {
        "seed": seed,
        "drawers": 1 + len(spec.places),
        "way_mm": (1e3 * way).tolist(),
        "seen_px": [min(int((image == one).sum()) for image in seen) for one in bodies],
    }
    clock = time.process_time()
    both = _answer(frames[0], frames[1], axis, way) | {"cpu_s": time.process_time() - clock}
    return result | {"both": both, "alone": _answer(frames[0], frames[2], axis, way[:1])}


def _answer(before: DepthFrame, after: DepthFrame, axis: np.ndarray, way: np.ndarray) -> dict[str, Any]:
    """Number of parts found; error of axis [deg] and way [mm] of every true one, by the answer nearest to it."""
    try:
        found = estimate_joints(before, after)
    except AbstainError as error:
        return {"abstained": str(error)}
    moved = np.array([one.delta * one.axis_direction for one in found])
    errors = []
    for d in way:
        k = int(np.linalg.norm(moved - d * axis, axis=1).argmin())
        cosine = float(np.clip(found[k].axis_direction @ (np.sign(d) * axis), -1, 1))
        errors.append([k, float(np.degrees(np.arccos(cosine))), 1e3 * (found[k].delta - abs(float(d)))])
    return {"types": [one.joint_type for one in found], "errors": errors}


def _right(answer: dict[str, Any]) -> bool:
    """Every true motion has an answer of its own that is near it, and there are no more."""
    errors = answer.get("errors", [])
    near = all(axis < RIGHT_DEG and abs(way) < RIGHT_MM for _, axis, way in errors)
    return (
        bool(errors)
        and near
        and len({k for k, _, _ in errors}) == len(errors) == len(answer.get("types", ()))
    )


def print_tables(rows: list[dict[str, Any]]) -> None:
    """Pairs with clearly unlike motions, and the others; then one drawer alone."""
    rows = [row for row in rows if row["drawers"] > 1]
    hidden = [row for row in rows if min(row["seen_px"]) < SEEN_PX]
    in_sight = [row for row in rows if min(row["seen_px"]) >= SEEN_PX]
    alike = [row for row in in_sight if abs(np.diff(row["way_mm"])[0]) < 1e3 * UNLIKE_M]
    unlike = [row for row in in_sight if row not in alike]
    print(
        "| two moved | pairs | both right | one part found | other | abstained | axis [°] | way [mm] | CPU [s] |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, mine in (("unlike", unlike), ("alike", alike), ("one hardly in sight", hidden)):
        if mine:
            print(f"| {name} | {_counts([row['both'] for row in mine], 2)} |")
    print(
        "\n| one moved | pairs | right | two or more parts found | other | abstained | axis [°] | way [mm] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    print(f"| | {_counts([row['alone'] for row in rows], 1)} |")


def _counts(answers: list[dict[str, Any]], parts: int) -> str:
    right = [one for one in answers if _right(one)]
    abstained = sum("abstained" in one for one in answers)
    number = [len(one["types"]) for one in answers if "types" in one]
    miscounted = sum((k == 1) if parts == 2 else (k > 1) for k in number)
    errors = np.abs([e[1:] for one in right for e in one["errors"]]).reshape(-1, 2)
    spread = [f"{np.percentile(v, 50):.2f} / {np.percentile(v, 90):.2f}" if len(v) else "–" for v in errors.T]
    other = len(answers) - len(right) - miscounted - abstained
    cpu = [f"{np.median([one['cpu_s'] for one in answers]):.1f}"] if parts == 2 else []
    return " | ".join(map(str, [len(answers), len(right), miscounted, other, abstained, *spread, *cpu]))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--split", default="validation", choices=[s.name.lower() for s in Split])
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument(
        "--count", type=int, default=20, help="chests drawn; those of one drawer do not count"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    args = parser.parse_args()
    jobs = [(int(Split[args.split.upper()]), seed) for seed in range(args.first, args.first + args.count)]
    print_tables(run_jobs(measure, jobs, args.out / "rows.jsonl", args.jobs, "chests"))


if __name__ == "__main__":
    main()
