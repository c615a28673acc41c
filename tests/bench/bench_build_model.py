"""How exact is ``s2r build-model``? Prints a markdown table; no budget is asserted.

    python tests/bench/bench_build_model.py [--synthetic N] [--real] [--no-up] [--between]

Real rows need the single-view laptop clip (UT-Austin-RobIn/ScrewMimic, close_laptop_1, depth as 16-bit PNG) with its
pseudo truth (plane fits, good to 0.7 degrees and 8 mm) under ``$S2R_SHARED_DATA/screwmimic``. Axis errors keep the
sign: a reversed axis counts as 180 degrees. An interval holds the pseudo truth if it does when widened by how well that
is known (root of the sum of squares). With ``--between`` the clip's frames from between the two of a pair refine the
joint; the made-up pairs have none.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_host.perception import AbstainError, DepthFrame, JointMotion, estimate_joint, load_frame
from s2r_host.perception import synthetic as scenes
from s2r_host.perception.between import refined_between
from s2r_host.perception.estimate import UP
from s2r_host.perception.motion import line_distance

SHARED = Path(os.environ.get("S2R_SHARED_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
PSEUDO_TRUTH = (np.radians(0.7), np.radians(0.7), 8.0)  # axis [rad], motion [rad], hinge [mm]
REAL_PAIRS = ((6, 13), (1, 13), (4, 13), (2, 12), (8, 13), (9, 13), (5, 11), (3, 11), (1, 10), (1, 9), (2, 8))


@dataclass(frozen=True)
class Case:
    """One pair with its true motion, and how well that is known: axis [rad], motion [rad or m], hinge [mm]."""

    name: str
    before: DepthFrame
    after: DepthFrame
    truth: JointMotion
    known: tuple[float, float, float] = (0.0, 0.0, 0.0)
    between: tuple[DepthFrame, ...] = ()


@dataclass(frozen=True)
class Row:
    """Errors of one case; None where nothing was answered."""

    name: str
    true_amount: str
    answer: str
    axis_deg: float | None = None
    amount_error: float | None = None
    hinge_mm: float | None = None
    covered: tuple[bool, ...] = ()
    cpu_s: float = 0.0


def real_cases() -> Iterator[Case]:
    """Pairs of the laptop clip, if present."""
    clip = SHARED / "screwmimic" / "close_laptop_1"
    if not clip.is_dir():
        print(f"(no real views at {clip}; set S2R_SHARED_DATA)")
        return
    reference = json.loads((clip / "reference.json").read_text())
    axis = np.array(reference["axis_direction"]) / np.linalg.norm(reference["axis_direction"])
    point = np.array(reference["axis_point_at_y_minus_0_03_m"])
    angle = {int(k): np.radians(v) for k, v in reference["lid_plane_normal_angle_deg"].items()}
    for i, j in REAL_PAIRS:
        frames = [
            load_frame(clip / f"depth_mm/{k:04d}.png", "base", clip / "camera.json") for k in range(i, j + 1)
        ]
        views = [frame for frame in frames if isinstance(frame, DepthFrame)]
        truth = JointMotion("revolute", point, axis, float(angle[j] - angle[i])).positive()
        yield Case(f"real laptop {i}-{j}", views[0], views[-1], truth, PSEUDO_TRUTH, tuple(views[1:-1]))


def synthetic_cases(count: int) -> Iterator[Case]:
    """Made-up drawers and laptops."""
    for kind, make in (("drawer", scenes.drawer_pair), ("laptop", scenes.laptop_pair)):
        for seed in range(1000, 1000 + count):
            pair = make(np.random.default_rng(seed))
            yield Case(f"made-up {kind} {seed}", pair.before, pair.after, pair.motion)


def measure(case: Case, up: np.ndarray | None, *, between: bool) -> Row:
    """Estimate one case, with or without the frames between, and compare."""
    turn = case.truth.joint_type == "revolute"
    scale, unit = (180 / np.pi, "°") if turn else (1e3, " mm")
    amount = f"{case.truth.delta * scale:.1f}{unit}"
    start = time.process_time()
    try:
        found = estimate_joint(case.before, case.after, up=up)
        if between and case.between:
            found = refined_between(found, case.before, case.after, case.between, up=up)
    except AbstainError as error:
        return Row(case.name, amount, f"abstains: {str(error).split(':')[0].split(';')[0]}")
    cpu_s = time.process_time() - start
    if found.joint_type != case.truth.joint_type:
        return Row(case.name, amount, f"WRONG TYPE {found.joint_type}", cpu_s=cpu_s)
    axis = float(np.arccos(np.clip(found.axis_direction @ case.truth.direction, -1, 1)))
    foot = case.truth.origin
    hinge = float(line_distance(found.axis_origin_m, found.axis_direction, foot[None])[0]) if turn else None
    iv = found.intervals90
    half = 0.5 * (iv.delta[1] - iv.delta[0])
    covered = [
        axis < np.hypot(iv.axis_angle_rad, case.known[0]),
        abs(found.delta - case.truth.delta) < np.hypot(half, case.known[1]),
    ]
    if hinge is not None:
        covered.append(1e3 * hinge < np.hypot(1e3 * iv.axis_offset_m, case.known[2]))
    return Row(
        case.name, amount, found.joint_type, np.degrees(axis), (found.delta - case.truth.delta) * scale,
        None if hinge is None else hinge * 1e3, tuple(covered), cpu_s,
    )  # fmt: skip


def print_rows(rows: list[Row]) -> None:
    """Every case."""
    print(
        "| pair | true motion | answer | axis error [°] | motion error [° or mm] | hinge [mm] | in 90 % | CPU [s] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for r in rows:
        numbers = (r.axis_deg, r.amount_error, r.hinge_mm)
        texts = ["" if v is None else f"{v:.2f}" for v in numbers]
        cover = "" if not r.covered else f"{sum(r.covered)}/{len(r.covered)}"
        print(f"| {r.name} | {r.true_amount} | {r.answer} | {' | '.join(texts)} | {cover} | {r.cpu_s:.1f} |")


def print_summary(kind: str, rows: list[Row]) -> None:
    """Median, 90th percentile and rates of one kind."""
    good = [r for r in rows if r.axis_deg is not None]
    if not good:
        return
    abstained = sum(r.answer.startswith("abstains") for r in rows)

    def pair(values: list[float]) -> str:
        return f"{np.percentile(values, 50):.2f} / {np.percentile(values, 90):.2f}"

    hinges = [r.hinge_mm for r in good if r.hinge_mm is not None]
    covered = 100 * np.mean([c for r in good for c in r.covered])
    cpu_s = np.median([r.cpu_s for r in good])
    print(
        f"| {kind} | {len(rows)} | {abstained} | {len(good)}/{len(rows) - abstained} |"
        f" {pair([float(r.axis_deg or 0) for r in good])} | {pair([abs(r.amount_error or 0) for r in good])} |"
        f" {pair(hinges) if hinges else ''} | {covered:.0f} % | {cpu_s:.1f} |"
    )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--synthetic", type=int, default=10, help="made-up pairs per kind")
    parser.add_argument("--real", action="store_true", help="only the real pairs")
    parser.add_argument("--no-up", action="store_true", help="do not believe hinges to be upright or level")
    parser.add_argument("--between", action="store_true", help="refine real joints by the frames between")
    options = parser.parse_args()
    up = None if options.no_up else UP
    rows = [measure(case, up, between=options.between) for case in real_cases()]
    print_rows(rows)
    groups = {"real laptop": rows}
    if not options.real:
        made_up = [measure(case, up, between=False) for case in synthetic_cases(options.synthetic)]
        for kind in ("drawer", "laptop"):
            groups[f"made-up {kind}"] = [r for r in made_up if f" {kind} " in r.name]
    print()
    print(
        "| kind | n | abstained | type right | axis [°] p50 / p90 | motion p50 / p90 | hinge [mm] | cover | CPU [s] |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for kind, group in groups.items():
        print_summary(kind, group)


if __name__ == "__main__":
    main()
