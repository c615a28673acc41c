"""How exact is the joint estimate from one pair of noisy single views? Prints markdown tables; no budget is
asserted.

    python tests/bench/bench_perception.py --split validation --count 30 --out runs/perception-validation
    python tests/bench/bench_perception.py --split test --count 100 --out runs/perception-test

Objects are procedural (s2r_sim.objects), views come from the stand-in's active-stereo camera, the part moves
8 to 50 % of its range but at least 3 cm or 15 degrees. Axis errors keep the sign: a reversed axis counts as
180 degrees. The transport error is the mean distance between corners of the part moved on from the second
view by the estimated and by the true joint, over 0.10 m or 45 degrees. Results are kept as JSON lines; a run
that was interrupted goes on where it stopped.

Several routes on the same pairs, one line each (weights from `s2r train model`):

    python tests/bench/bench_perception.py --split test --first 300 --count 30 --weights runs/model \\
        --route geometry,network,combined,no-interaction --out runs/perception-routes

A second table is of all pairs, an abstention and a wrong type counted as infinitely far off: the share of pairs within
the 90th percentile aimed at, and the 90th percentile itself (infinite where more than a tenth of the pairs failed).

geometry: what `estimate_joint` does by itself. vague: the same, also where a turn is known to half of itself only.
network: the pair network's votes alone. combined, vague-combined: the hypotheses of geometry weighed by them.
baseline: a network in the manner of Ditto (`s2r train baseline`, its folder with --baseline; needs PyTorch).
no-interaction: the network given the first view twice, as in the ablation of Sim2Real² without interaction.
"""

from __future__ import annotations

import argparse
import copy
import hashlib
import importlib.util
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from refusals import told_by

from s2r_host.perception import (
    AbstainError,
    BadViewError,
    DepthFrame,
    JointEstimate,
    JointMotion,
    estimate_joint,
)
from s2r_host.perception.change import compare
from s2r_host.perception.estimate import (
    Search,
    conclude,
    look_for_motion,
    prepare,
    sure_enough,
    weighed,
)
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import line_distance
from s2r_host.perception.pair_network import WEIGHTS, PairNetworkRuntime
from s2r_host.perception.verdict import KNOWN_TO, VAGUELY
from s2r_host.perception.view import DepthView
from s2r_sim.batch import run_jobs
from s2r_sim.objects.pairs import Pair, draw_pair
from s2r_sim.objects.splits import Split

CATEGORIES = {
    "chest": "drawer",
    "laptop": "laptop",
    "faucet": "faucet",
    "door": "door",
    "lid": "lid",
    "dial": "dial",
}
COMMANDED = {"prismatic": 0.10, "revolute": np.radians(45)}
SEEN_PX = 150
# Aims for the 90th percentile: axis [deg], hinge line [mm], state [mm or deg].
AIMS_P90 = {
    "drawer": {"axis": 3.0, "state": 5.0},
    "laptop": {"axis": 6.0, "line": 15.0, "state": 3.0},
    "faucet": {"axis": 5.0, "line": 8.0, "state": 5.0},
}
AIMS_P90["chest"] = AIMS_P90["drawer"]
SEARCHING = ("geometry", "vague", "combined", "vague-combined")
ROUTES = (*SEARCHING, "network", "baseline", "no-interaction")


def true_motion(pair: Pair) -> JointMotion:
    """The motion between the two views, its direction with the sense of the motion."""
    joint = pair.joint
    return JointMotion(
        joint.joint_type, np.array(joint.origin_m), np.array(joint.direction), pair.delta
    ).positive()


def frames(pair: Pair, colour: bool = True) -> tuple[DepthFrame, DepthFrame]:
    """What the host gets."""
    before, after = (pair.colour_before, pair.colour_after) if colour else (None, None)
    return (
        DepthFrame(pair.depth_before, pair.K, pair.X_base_camera, before),
        DepthFrame(pair.depth_after, pair.K, pair.X_base_camera, after),
    )


def measure(sight: str, kind: str, split: int, seed: int) -> dict[str, Any]:
    """Draw one pair and judge the answer."""
    pair = draw_pair(kind, Split(split), seed, noise=sight != "exact")
    return {"kind": kind, "seed": seed} | assess(pair, colour=sight != "depth")


def measure_routes(
    sight: str,
    weights: str | None,
    baseline: str | None,
    routes: tuple[str, ...],
    kind: str,
    split: int,
    seed: int,
) -> dict[str, Any]:
    """Draw one pair and judge the answer of each route; a row per route."""
    pair = draw_pair(kind, Split(split), seed, noise=sight != "exact")
    looked = Looked(*frames(pair, colour=sight != "depth"))
    rows = {}
    for route in routes:
        start, before_s = time.process_time(), looked.cpu_s
        try:
            found = answer(route, looked, weights, baseline, seed)
        except (AbstainError, BadViewError) as error:
            verdict: dict[str, Any] = {"abstained": str(error)}
        else:
            verdict = judge(found, pair) if isinstance(found, JointMotion) else judge_estimate(found, pair)
        # What several routes share counts for each of them.
        cpu_s = time.process_time() - start - (looked.cpu_s - before_s)
        shared = looked.cpu_s if route in SEARCHING else 0.0
        rows[route] = about(pair) | verdict | {"cpu_s": cpu_s + shared}
    return {"kind": kind, "seed": seed, "routes": rows}


class Looked:
    """Two views and the search for their motion, made once for all routes; `estimate_joint` does the same steps."""

    def __init__(self, before: DepthFrame, after: DepthFrame) -> None:
        self.before, self.after = before, after
        self.cpu_s = 0.0

    @cached_property
    def found(self) -> tuple[Scene, Scene, Search, list[str], np.random.Generator]:
        """The scene as compared, the scene with its revealed level, the candidates, warnings, and the generator."""
        start, rng = time.process_time(), np.random.default_rng(0)
        try:
            scene, warnings = prepare(self.before, self.after, None, None, None, rng)
            return scene, *look_for_motion(scene, rng), warnings, rng
        finally:
            self.cpu_s += time.process_time() - start


def answer(
    route: str, looked: Looked, weights: str | None, baseline: str | None, seed: int
) -> JointEstimate | JointMotion:
    """What one route says of two views.

    Raises:
        AbstainError: Nothing.
        BadViewError: That it can not be asked.
    """
    rng = np.random.default_rng([seed, 5])
    if route in SEARCHING:
        first, scene, found, warnings, after = looked.found
        known_to = VAGUELY if route.startswith("vague") else KNOWN_TO
        if route.endswith("combined"):
            belief = runtime(weights).belief(first, np.random.default_rng([0, 1]))
            if belief is not None:
                found = weighed(found, belief, scene, None, np.random.default_rng([0, 2]))
                known_to = sure_enough(known_to, found, belief)
        return conclude(found, scene, warnings, copy.deepcopy(after), known_to=known_to)
    if route in ("network", "baseline"):
        scene, _ = prepare(looked.before, looked.after, None, None, None, rng)
        if route == "baseline":
            return baseline_runtime(str(baseline)).motion(scene, rng)
    else:
        # Not by `prepare`, which refuses the same view twice: what would the network make of it?
        view = DepthView(looked.before)
        every = np.ones(len(view.points), dtype=bool)
        scene = Scene(view, view, compare(view, view), every, every)
    belief = runtime(weights).belief(scene, rng)
    if belief is None:
        raise AbstainError("hardly a point is believed to have moved with a part")
    return belief.opinion.best()


@cache
def runtime(weights: str | None) -> PairNetworkRuntime:
    """The pair network, once per process."""
    return PairNetworkRuntime() if weights is None else PairNetworkRuntime(Path(weights))


@cache
def baseline_runtime(folder: str) -> Any:
    """The baseline, once per process. Its module needs PyTorch, which the other routes do without."""
    from s2r_host.learn.baseline import BaselineRuntime

    return BaselineRuntime(Path(folder))


def check_baseline(folder: Path | None, parser: argparse.ArgumentParser) -> None:
    """End the program if the route of that name cannot be gone, before pairs are drawn for it."""
    if folder is None:
        parser.error("the route baseline needs --baseline FOLDER; train one: s2r train baseline --out FOLDER")
    if importlib.util.find_spec("torch") is None:
        parser.error("the route baseline needs PyTorch: install the extra 'learn' (make test-learn does)")
    with told_by(parser):
        baseline_runtime(str(folder))


def weights_hash(folder: Path, files: str = "*.onnx") -> str:
    """Of a network's graphs: rows of one network are none of another. What is read off it later does not count."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob(files)):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def about(pair: Pair) -> dict[str, Any]:
    """Truth and circumstances as plain values."""
    truth = true_motion(pair)
    return {
        "type_true": truth.joint_type,
        "delta_true": truth.delta,
        "azimuth_deg": np.degrees(pair.azimuth_rad),
        "elevation_deg": np.degrees(pair.elevation_rad),
        "distance_m": pair.distance_m,
        "part_px": [int(pair.part_before.sum()), int(pair.part_after.sum())],
    }


def assess(pair: Pair, colour: bool = True) -> dict[str, Any]:
    """Truth, answer and errors as plain values."""
    row, start = about(pair), time.process_time()
    try:
        found = estimate_joint(*frames(pair, colour))
    except AbstainError as error:
        return row | {"abstained": str(error), "cpu_s": time.process_time() - start}
    return row | {"cpu_s": time.process_time() - start} | judge_estimate(found, pair)


def judge(found: JointMotion, pair: Pair) -> dict[str, Any]:
    """Errors of a bare motion."""
    truth = true_motion(pair)
    row: dict[str, Any] = {"type": found.joint_type, "delta": found.delta}
    if found.joint_type != truth.joint_type:
        return row
    axis_deg, line_mm = axis_errors(found, truth, pair)
    return row | {
        "axis_deg": axis_deg,
        "line_mm": line_mm,
        "delta_error": found.delta - truth.delta,
        "transport_mm": transport_mm(found, truth, pair),
        "covered": {},
    }


def judge_estimate(found: JointEstimate, pair: Pair) -> dict[str, Any]:
    """Errors of an estimate, with its intervals and its other hypotheses."""
    truth = true_motion(pair)
    row = judge(found.motion, pair) | {
        "residual_mm": 1e3 * found.residual_m,
        "explained": found.explained,
        "hypotheses": [
            [h.motion.joint_type, round(h.cost, 4), *axis_errors(h.motion, truth, pair)]
            for h in found.hypotheses
        ],
    }
    if "axis_deg" not in row:
        return row
    iv = found.intervals90
    covered = {
        "axis": row["axis_deg"] < np.degrees(iv.axis_angle_rad),
        "delta": iv.delta[0] <= truth.delta <= iv.delta[1],
    }
    if truth.joint_type == "revolute":
        covered["line"] = row["line_mm"] < 1e3 * iv.axis_offset_m
    return row | {
        "covered": {name: bool(value) for name, value in covered.items()},
        "interval": [np.degrees(iv.axis_angle_rad), 1e3 * iv.axis_offset_m, iv.delta[1] - iv.delta[0]],
    }


def axis_errors(found: JointMotion, truth: JointMotion, pair: Pair) -> tuple[float, float]:
    """Angle between the axes [deg], sign aware, and distance [mm] of the lines beside the part."""
    found = found.positive()
    angle = float(np.degrees(np.arccos(np.clip(found.direction @ truth.direction, -1, 1))))
    middle = (pair.part_points.min(axis=0) + pair.part_points.max(axis=0)) / 2
    foot = truth.origin + ((middle - truth.origin) @ truth.direction) * truth.direction
    return angle, 1e3 * float(line_distance(found.origin, found.direction, foot[None])[0])


def transport_mm(found: JointMotion, truth: JointMotion, pair: Pair) -> float:
    """Mean distance of the part's corners, moved on from the second view by both joints [mm]."""
    X = truth.transform()
    after = pair.part_points @ X[:3, :3].T + X[:3, 3]
    ends = []
    for motion in (found, truth):
        T = replace(motion, delta=COMMANDED[truth.joint_type]).transform()
        ends.append(after @ T[:3, :3].T + T[:3, 3])
    return 1e3 * float(np.linalg.norm(ends[0] - ends[1], axis=1).mean())


def print_tables(rows: list[dict[str, Any]]) -> None:
    """One line per category (and route): median / 90th percentile over the answered pairs of the right type; then
    what that is of all pairs."""
    head = (
        "category", "n", "hidden", "abstained", "type right", "axis [°]", "line [mm]", "state",
        "transport [mm]", "cover axis / line / state", "CPU [s]",
    )  # fmt: skip
    print(f"| {' | '.join(head)} |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    groups = list(of_routes(rows))
    for name, _, mine in groups:
        print(_summary(name, mine))
    head = (
        "of all pairs", "n", "axis within", "line within", "state within", "all within", "axis p90 [°]",
        "line p90 [mm]", "state p90 [mm, °]",
    )  # fmt: skip
    print(f"\n| {' | '.join(head)} |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, kind, mine in groups:
        if kind in AIMS_P90:
            print(_of_all(name, kind, mine))


def of_routes(rows: list[dict[str, Any]]) -> Iterator[tuple[str, str, list[dict[str, Any]]]]:
    """Name, kind and rows of every category, or of every route of every category."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        of_kind = [row for row in rows if row["kind"] == kind]
        name: str = CATEGORIES.get(kind) or kind
        if "routes" not in of_kind[0]:
            yield name, kind, of_kind
            continue
        for route in of_kind[0]["routes"]:
            yield f"{name}, {route}", kind, [row["routes"][route] for row in of_kind]


def errors_of_all(rows: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Errors of all pairs, shape (pairs,) each: axis [deg], line [mm], state [mm or deg]; infinite without an answer
    of the right type. Slides have no line."""
    turns = rows[0]["type_true"] == "revolute"
    scale = 180 / np.pi if turns else 1e3
    answered = [row if "axis_deg" in row else None for row in rows]
    errors = {"axis": [np.inf if row is None else row["axis_deg"] for row in answered]}
    if turns:
        errors["line"] = [np.inf if row is None else row["line_mm"] for row in answered]
    errors["state"] = [np.inf if row is None else scale * abs(row["delta_error"]) for row in answered]
    return {name: np.array(values) for name, values in errors.items()}


def _of_all(name: str, kind: str, rows: list[dict[str, Any]]) -> str:
    aims, errors = AIMS_P90[kind], errors_of_all(rows)
    within = {key: values <= aims[key] for key, values in errors.items()}

    def share(inside: np.ndarray) -> str:
        return f"{100 * np.mean(inside):.0f} %"

    # The value that nine of ten pairs do not exceed; nothing lies between a number and infinity.
    p90 = {key: np.percentile(values, 90, method="inverted_cdf") for key, values in errors.items()}
    cells = [name, str(len(rows))]
    cells += [share(within[key]) if key in within else "–" for key in ("axis", "line", "state")]
    cells.append(share(np.all(list(within.values()), axis=0)))
    cells += [
        f"{p90[key]:.2f}".replace("inf", "∞") if key in p90 else "–" for key in ("axis", "line", "state")
    ]
    return f"| {' | '.join(cells)} |"


def _summary(name: str, rows: list[dict[str, Any]]) -> str:
    hidden = sum(min(row["part_px"]) < SEEN_PX for row in rows)
    answered = [row for row in rows if "type" in row]
    good = [row for row in answered if "axis_deg" in row]
    turns = rows[0]["type_true"] == "revolute"
    scale, unit = (180 / np.pi, "°") if turns else (1e3, " mm")

    def spread(value: Callable[[dict[str, Any]], float], suffix: str = "") -> str:
        values = [value(row) for row in good]
        if not values:
            return "–"
        return f"{np.percentile(values, 50):.2f} / {np.percentile(values, 90):.2f}{suffix}"

    def cover(name: str) -> str:
        values = [row["covered"][name] for row in good if name in row["covered"]]
        return f"{100 * np.mean(values):.0f}" if values else "–"

    cells = [
        name,
        str(len(rows)),
        str(hidden),
        str(len(rows) - len(answered)),
        f"{len(good)}/{len(answered)}",
        spread(lambda row: row["axis_deg"]),
        spread(lambda row: row["line_mm"]) if turns else "–",
        spread(lambda row: abs(row["delta_error"]) * scale, unit),
        spread(lambda row: row["transport_mm"]),
        f"{cover('axis')} / {cover('line')} / {cover('delta')} %",
        f"{np.median([row['cpu_s'] for row in rows]):.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="chest,laptop,faucet", help="comma-separated")
    parser.add_argument("--split", default="validation", choices=[s.name.lower() for s in Split])
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=30, help="pairs per kind")
    parser.add_argument(
        "--sight",
        default="stereo",
        choices=["stereo", "depth", "exact"],
        help="stereo depth with colour, stereo depth alone, or exact depth with colour (one folder each)",
    )
    parser.add_argument(
        "--route",
        help=f"{', '.join(ROUTES)}: some of them, comma-separated, on the same pairs",
    )
    parser.add_argument("--weights", type=Path, help="folder of a trained pair network")
    parser.add_argument(
        "--baseline", type=Path, help="folder of a trained baseline, for the route of that name"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--json", action="store_true", help="print the rows instead of tables")
    args = parser.parse_args()
    split = Split[args.split.upper()]
    seeds = range(args.first, args.first + args.count)
    jobs = [(kind, int(split), seed) for seed in seeds for kind in args.kinds.split(",")]
    baseline: str | None = None
    if args.route is None:
        work, file = partial(measure, args.sight), "rows.jsonl"
    else:
        routes = tuple(args.route.split(","))
        if unknown := set(routes) - set(ROUTES):
            parser.error(f"unknown route {', '.join(sorted(unknown))}; known are {', '.join(ROUTES)}")
        if "baseline" in routes:
            check_baseline(args.baseline, parser)
            baseline = str(args.baseline)
        weights = None if args.weights is None else str(args.weights)
        work, file = partial(measure_routes, args.sight, weights, baseline, routes), "routes.jsonl"
    conditions: dict[str, Any] = {"--sight": args.sight}
    if args.route is not None:
        conditions |= {"--route": args.route, "--weights": weights_hash(args.weights or WEIGHTS)}
        if baseline is not None:
            conditions["--baseline"] = weights_hash(args.baseline, "weights.safetensors")
    with told_by(parser):
        rows = run_jobs(work, jobs, args.out / file, args.jobs, "pairs", conditions=conditions)
    if args.json:
        print(json.dumps(rows, indent=1))
    else:
        print_tables(rows)


if __name__ == "__main__":
    main()
