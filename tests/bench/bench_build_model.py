"""How exact is ``s2r build-model``? Prints a markdown table; no budget is asserted.

    python tests/bench/bench_build_model.py [--synthetic N] [--real] [--no-up] [--between] [--reference] [--pairs I-J,…]

Real rows need the single-view laptop clip (UT-Austin-RobIn/ScrewMimic, close_laptop_1, depth as 16-bit PNG) with its
pseudo truth (plane fits, good to 0.7 degrees and 8 mm) under ``$S2R_SHARED_DATA/screwmimic``. Axis errors keep the
sign: a reversed axis counts as 180 degrees. An interval holds the pseudo truth if it does when widened by how well that
is known (root of the sum of squares). With ``--between`` the clip's frames from between the two of a pair refine the
joint; the made-up pairs have none.

How well is the reference known? With ``--reference`` planes are fitted to the laptop's deck and to the table beside it
in some frames of the clip, and the angles by which the pseudo truth's hinge stands out of them are printed: a hinge is
parallel to its deck. Answers then tell how far they stand out of the reference in that direction (along the mean of the
decks' normals; towards the deck is positive).
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.perception import AbstainError, DepthFrame, JointMotion, estimate_joint, load_frame
from s2r_host.perception import synthetic as scenes
from s2r_host.perception.between import refined_between
from s2r_host.perception.estimate import UP
from s2r_host.perception.frames import backproject
from s2r_host.perception.motion import line_distance

SHARED = Path(os.environ.get("S2R_SHARED_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
CLIP = SHARED / "screwmimic" / "close_laptop_1"
PSEUDO_TRUTH = (np.radians(0.7), np.radians(0.7), 8.0)  # axis [rad], motion [rad], hinge [mm]
REFERENCE_FRAMES = (1, 4, 6, 9, 13)
FLAT_M = 0.006  # half the height in which a level surface is looked for
TRIMMED = 2.5  # what is further off a plane than so many times its spread is not of it
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
    direction: np.ndarray | None = None


def real_cases(pairs: tuple[tuple[int, int], ...] = REAL_PAIRS) -> Iterator[Case]:
    """Pairs of the laptop clip, if present."""
    if not CLIP.is_dir():
        print(f"(no real views at {CLIP}; set S2R_SHARED_DATA)")
        return
    reference = json.loads((CLIP / "reference.json").read_text())
    axis = hinge_of(reference)
    point = np.array(reference["axis_point_at_y_minus_0_03_m"])
    angle = {int(k): np.radians(v) for k, v in reference["lid_plane_normal_angle_deg"].items()}
    for i, j in pairs:
        frames = [
            load_frame(CLIP / f"depth_mm/{k:04d}.png", "base", CLIP / "camera.json") for k in range(i, j + 1)
        ]
        views = [frame for frame in frames if isinstance(frame, DepthFrame)]
        truth = JointMotion("revolute", point, axis, float(angle[j] - angle[i])).positive()
        yield Case(f"real laptop {i}-{j}", views[0], views[-1], truth, PSEUDO_TRUTH, tuple(views[1:-1]))


@dataclass(frozen=True, eq=False)
class LevelPlanes:
    """Unit normals of the laptop's deck and of the table in a frame, shape (3,), and the spread of their points."""

    frame: int
    deck: np.ndarray
    table: np.ndarray
    deck_mm: float
    table_mm: float


def hinge_of(reference: dict[str, Any]) -> np.ndarray:
    """Unit direction of the pseudo truth's hinge, base frame, shape (3,)."""
    return np.array(reference["axis_direction"]) / np.linalg.norm(reference["axis_direction"])


def level_plane(points: np.ndarray, z_m: float) -> tuple[np.ndarray, float]:
    """The nearly level plane near a height: its unit normal, upwards, shape (3,), and the spread [m] of its points.

    Args:
        points: Of one surface and of what lies beside it [m], shape (n, 3).
        z_m: About where it is.
    """
    p = points[np.abs(points[:, 2] - z_m) < FLAT_M]
    slopes, off = fitted_heights(p)
    for _ in range(10):
        kept = np.abs(off) < TRIMMED * off.std()
        if kept.all():
            break
        p = p[kept]
        slopes, off = fitted_heights(p)
    normal = np.append(-slopes, 1.0)
    return normal / np.linalg.norm(normal), float(off.std())


def fitted_heights(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes along x and y, shape (2,), of the plane that fits points (n, 3) best, and their heights above it."""
    A = np.column_stack([p[:, :2], np.ones(len(p))])
    plane, *_ = np.linalg.lstsq(A, p[:, 2], rcond=None)
    return plane[:2], p[:, 2] - A @ plane


def out_of(direction: np.ndarray, normal: np.ndarray) -> float:
    """How far a direction stands out of a plane [deg], positive upwards."""
    return float(np.degrees(np.arcsin(np.clip(direction @ normal, -1.0, 1.0))))


def reference_planes() -> list[LevelPlanes]:
    """Deck and table in the frames of the clip that are looked at."""
    reference = json.loads((CLIP / "reference.json").read_text())
    (x0, x1), (y0, y1), _ = reference["object_box_base_frame_m"]
    found = []
    for k in REFERENCE_FRAMES:
        frame = load_frame(CLIP / f"depth_mm/{k:04d}.png", "base", CLIP / "camera.json")
        assert isinstance(frame, DepthFrame)
        p = backproject(frame.depth_m, frame.K, frame.X_base_camera)[frame.depth_m > 0]
        inside = (p[:, 0] > x0) & (p[:, 0] < x1) & (p[:, 1] > y0) & (p[:, 1] < y1)
        # The table goes on around the box; 5 cm of it, and the laptop's own rim, are left out.
        wide = (p[:, 0] > x0 - 0.05) & (p[:, 0] < x1 + 0.05) & (p[:, 1] > y0 - 0.05) & (p[:, 1] < y1 + 0.05)
        deck = level_plane(p[inside], reference["base_top_plane_z_m"])
        table = level_plane(p[~wide], reference["table_plane_z_m"])
        found.append(LevelPlanes(k, deck[0], table[0], 1e3 * deck[1], 1e3 * table[1]))
    return found


def print_reference(rows: list[Row]) -> None:
    """Planes of the clip, and how far the reference and the answers stand out of them."""
    hinge = hinge_of(json.loads((CLIP / "reference.json").read_text()))
    planes = reference_planes()
    print("\n| frame | hinge out of the deck [°] | out of the table [°] | deck to table [°] | spread [mm] |")
    print("|---|---|---|---|---|")
    for one in planes:
        apart = np.degrees(np.arccos(np.clip(one.deck @ one.table, -1.0, 1.0)))
        print(
            f"| {one.frame} | {out_of(hinge, one.deck):.2f} | {out_of(hinge, one.table):.2f} | {apart:.2f} |"
            f" {one.deck_mm:.1f}, {one.table_mm:.1f} |"
        )
    deck, table = (
        np.mean(normals, axis=0) for normals in ([p.deck for p in planes], [p.table for p in planes])
    )
    deck, table = deck / np.linalg.norm(deck), table / np.linalg.norm(table)
    print(
        f"mean of the frames: {out_of(hinge, deck):.2f}° out of the deck, {out_of(hinge, table):.2f}° out of the table"
    )
    out = out_of(hinge, deck)
    print("\n| pair | out of the deck [°] | from the reference towards the deck [°] |\n|---|---|---|")
    for row in rows:
        if row.direction is not None:
            mine = out_of(row.direction * np.sign(row.direction @ hinge), deck)
            print(f"| {row.name} | {mine:.2f} | {(out - mine) * np.sign(out):.2f} |")


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
        None if hinge is None else hinge * 1e3, tuple(covered), cpu_s, found.axis_direction,
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
    parser.add_argument("--pairs", help="only these real pairs, comma-separated, e.g. 6-13,8-13")
    parser.add_argument("--reference", action="store_true", help="how well the real reference is known")
    options = parser.parse_args()
    if options.reference and not CLIP.is_dir():
        parser.error(f"--reference needs the clip, which is not at {CLIP}; set S2R_SHARED_DATA")
    up = None if options.no_up else UP
    pairs = REAL_PAIRS
    if options.pairs is not None:
        pairs = tuple(pair for pair in REAL_PAIRS if "{}-{}".format(*pair) in options.pairs.split(","))
        if len(pairs) < len(options.pairs.split(",")):
            known = ", ".join(f"{i}-{j}" for i, j in REAL_PAIRS)
            parser.error(f"--pairs {options.pairs}: known are {known}")
    rows = [measure(case, up, between=options.between) for case in real_cases(pairs)]
    print_rows(rows)
    if options.reference:
        print_reference(rows)
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
