"""Does the first push move the part? The push network, and what ``s2r run`` pushes first, against random pushes and a
rule, on the same unseen objects.

    s2r data pushes --split train --objects 150 --pushes 200 --out runs/pushes
    s2r data pushes --split validation --objects 10 --pushes 200 --out runs/pushes
    s2r train affordance --data runs/pushes --out runs/affordance
    python tests/bench/bench_affordance.py --count 20 --out runs/affordance-test

Every method gets the same noisy view and one push of 8 cm with a flying fingertip: the first of its proposals
whose start is free, out of 100. A push counts when the part moves 3 cm or 15 degrees. Random: any point of the
object, any direction within 70 degrees of straight in. Rule: the points that stand out furthest towards the
camera, pushed straight in, those in the middle first. Run: what `s2r run` would push first at a drawer, laptop or
faucet if nothing were out of the arm's reach: its own proposals in its own order, with its own way past the touch
and its finger's tilt. It means to move a part only a little, hence also "run, 8 cm" with the way of the others.
The meant way: every push means the place it touches to go along with the fingertip, and so do the run's, whose
directions are those of its believed joints (a drawer's front into its cabinet, a lid's face about its lower edge, a
lever about its believed axis). A useful motion went the meant way where the joint's true motion takes that place
within 90 degrees of the push, and against it otherwise. Joints grow as drawers and lids open.
"Could": objects with at least one useful push among all 100 random ones and among all 100 of the network's; no choice
among them can do better (--could 0 leaves it out). Intervals are Wilson's, 95 %. Results are kept as JSON lines; an
interrupted run goes on. --pictures draws the objects on which the network's push failed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice, pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from bench_perception import weights_hash
from refusals import told_by

from s2r_host.errors import SceneError
from s2r_host.motion.fingertip import CLOSED_GRIPPER
from s2r_host.motion.push_proposals import PushProposal
from s2r_host.motion.scene import observed_scene
from s2r_host.perception.affordance import WEIGHTS, Affordance, PushNetworkRuntime
from s2r_host.perception.errors import BadViewError
from s2r_host.perception.frames import DepthFrame, project
from s2r_host.perception.object_cloud import ObjectCloud, object_cloud
from s2r_host.run.first_push import pushables
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import DRAWER, FAUCET, LAPTOP, Task
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.catalogue import KINDS
from s2r_sim.objects.naming import BASE_BODY, PART_BODY
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.push_data import PART, pixel_labels, with_room
from s2r_sim.objects.pushes import TRAVEL_M, PushScene, useful
from s2r_sim.objects.scene import JointTruth, joint_truth, qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng

CONE_RAD = np.deg2rad(70)
STANDING_OUT = 0.98
TRIES = 100
RIGHT_WAY_DEG = 90.0
METHODS = ("random", "rule", "network", "run", "run, 8 cm")
TASKS = {"drawer": DRAWER, "chest": DRAWER, "laptop": LAPTOP, "faucet": FAUCET}  # kinds that `s2r run` knows


@dataclass(frozen=True, eq=False)
class Push:
    """A push as `PushScene.push` takes it."""

    point: np.ndarray
    direction: np.ndarray
    travel_m: float = TRAVEL_M
    axis: np.ndarray | None = None


@lru_cache(maxsize=1)
def runtime(folder: str) -> PushNetworkRuntime:
    """The network, loaded once per process."""
    return PushNetworkRuntime(Path(folder))


def first_pushes(
    kind: str, split: int, seed: int, weights: str, pictures: str, could: int = TRIES
) -> dict[str, Any]:
    """One object: what each method's first push does, and whether any of its first ``could`` ones is useful."""
    rng = split_rng(kind, Split(split), seed)
    spec = with_room(rng, KINDS[kind].draw(rng))
    model = table_scene(spec).compile()
    camera = DepthCamera(model, place_camera(rng, model, spec.q_start)[0])
    qpos = qpos_at(model, spec.q_start)
    view = camera.capture(qpos)
    frame = DepthFrame(view.depth_m, camera.rig.K, camera.X_base_camera, None)
    try:
        cloud = object_cloud(frame, rng)
    except BadViewError:
        return {"kind": kind, "seed": seed, "out_of_sight": True}
    found = runtime(weights).judge(cloud, rng)
    pushes: dict[str, list[Push]] = {
        "random": [Push(*random_push(cloud, rng)) for _ in range(TRIES)],
        "rule": [Push(*one) for one in ruled_pushes(cloud, camera.X_base_camera)],
        "network": [Push(p.point, p.direction) for p in found.proposals[:TRIES]],
    }
    if kind in TASKS:
        pushes["run"] = pushes_of_run(TASKS[kind], frame, rng)
        pushes["run, 8 cm"] = [replace(one, travel_m=TRAVEL_M) for one in pushes["run"]]
    scene, joint = PushScene(spec), joint_truth(model, spec)
    label = pixel_labels(camera.exact_sight(qpos), model.body(BASE_BODY).id, model.body(PART_BODY).id)
    row: dict[str, Any] = {"kind": kind, "seed": seed, "part_px": int((label == PART).sum())}
    row["style"] = getattr(spec, "style", None)
    for method, candidates in pushes.items():
        row[method] = tried(scene, kind, candidates, could if method in ("random", "network") else 0)
        first = row[method]["blocked"]
        row[method]["on_part"] = first is not None and shows(label, frame, candidates[first].point) == PART
        if first is not None:
            row[method]["way_deg"] = way_deg(joint, candidates[first], row[method]["delta"])
    first = row["network"]["blocked"] or 0
    row["likelihood"] = found.proposals[first].likelihood
    if pictures and not row["network"]["useful"]:
        path = Path(pictures) / f"{kind}-{seed}.png"
        draw(path, view.colour, label, frame, found, first, row)
    return row


def tried(scene: PushScene, kind: str, candidates: list[Push], could: int) -> dict[str, Any]:
    """What the first push does whose start is free, and whether any of the first ``could`` ones is useful."""
    row: dict[str, Any] = {"delta": 0.0, "blocked": None, "useful": False, "any": False}
    for k, one in enumerate(candidates):
        if row["blocked"] is not None and (k >= could or row["any"]):
            break
        result = scene.push(one.point, one.direction, one.travel_m, one.axis)
        if row["blocked"] is None and not result.blocked:
            row |= {"delta": result.delta, "blocked": k, "useful": useful(kind, result.delta)}
        row["any"] = row["any"] or useful(kind, result.delta)
    return row


def way_deg(joint: JointTruth, push: Push, delta: float) -> float | None:
    """Angle [deg] between a push and the way on which its place sets out with the joint; None where neither moved."""
    axis, origin = np.array(joint.direction), np.array(joint.origin_m)
    way = axis if joint.joint_type == "prismatic" else np.cross(axis, push.point - origin)
    length = float(np.linalg.norm(way))
    if delta == 0.0 or length == 0.0:
        return None
    return float(np.degrees(np.arccos(np.clip(np.sign(delta) * (way @ push.direction) / length, -1.0, 1.0))))


def pushes_of_run(task: Task, frame: DepthFrame, rng: np.random.Generator) -> list[Push]:
    """The first pushes `s2r run` would think of; none where it sees nothing that looks like its part."""
    settings = RunSettings(target=None, out=Path("never-written"), task=task)
    try:
        scene = observed_scene(frame)
        offered = (one for some in pushables(settings, scene, frame, rng) for one in some.proposals)
        return [as_run_does(one) for one in islice(offered, TRIES)]
    except SceneError:
        return []


def as_run_does(proposal: PushProposal) -> Push:
    """A push of the arm's fingertip as one of the flying finger: same first touch, way and tilt."""
    R, d = proposal.X_base_tool[:3, :3], proposal.direction
    travel = float(np.linalg.norm(proposal.p_end - proposal.p_contact))
    return Push(proposal.p_contact + CLOSED_GRIPPER.ahead_m(R, d) * d, d, travel, R[:, 2])


def shows(label: np.ndarray, frame: DepthFrame, point: np.ndarray) -> int:
    """True label of the pixel in which a point is seen; 0 outside the image."""
    u, v = pixel(frame, point)
    inside = 0 <= v < label.shape[0] and 0 <= u < label.shape[1]
    return int(label[v, u]) if inside else 0


def pixel(frame: DepthFrame, point: np.ndarray) -> tuple[int, int]:
    """Column and row of a point of the base frame."""
    (u, v), _ = project(point, frame.K, frame.X_base_camera)
    return round(u), round(v)


def draw(
    path: Path,
    colour: np.ndarray,
    label: np.ndarray,
    frame: DepthFrame,
    found: Affordance,
    first: int,
    row: dict[str, Any],
) -> None:
    """The view with the part outlined, the actionability, the belief about the part, and the first push."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    v, u = np.divmod(found.cloud.pixels, label.shape[1])
    push = found.proposals[first]
    tail, tip = pixel(frame, push.point - 0.06 * push.direction), pixel(frame, push.point)
    figure, axes = plt.subplots(1, 3, figsize=(15, 5), layout="constrained")
    for ax, value, title in (
        (axes[0], None, f"{row['kind']} {row['seed']}: moved {row['network']['delta']:.3f}"),
        (axes[1], found.actionability, "actionability"),
        (axes[2], found.part, "belongs to the part"),
    ):
        ax.imshow(colour)
        ax.contour(label == PART, [0.5], colors="lime", linewidths=1)
        if value is not None:
            ax.scatter(u, v, c=value, s=3, vmin=0, vmax=1, cmap="turbo")
        ax.annotate("", tip, tail, arrowprops={"arrowstyle": "->", "color": "red", "lw": 2})
        ax.set(xlim=(u.min() - 40, u.max() + 40), ylim=(v.max() + 40, v.min() - 40), title=title)
        ax.axis("off")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=60)
    plt.close(figure)


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


def share(results: list[dict[str, Any]]) -> str:
    """Share of useful first pushes."""
    return wilson95(sum(one["useful"] for one in results), len(results)) if results else "–"


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
    parser.add_argument("--first", type=int, default=2000, help="first seed")
    parser.add_argument("--count", type=int, default=20, help="objects per kind")
    parser.add_argument(
        "--weights",
        type=Path,
        default=WEIGHTS,
        help="folder of the trained network [default: the shipped one]",
    )
    parser.add_argument("--split", choices=["validation", "test"], default="test")
    parser.add_argument("--could", type=int, default=TRIES, help="pushes tried for 'could'")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of failures")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    args = parser.parse_args()
    kinds = args.kinds.split(",")
    seeds = range(args.first, args.first + args.count)
    split, pictures = int(Split[args.split.upper()]), str(args.pictures or "")
    jobs = [(kind, split, seed, str(args.weights), pictures, args.could) for seed in seeds for kind in kinds]
    conditions, rows_file = {"--weights": weights_hash(args.weights)}, args.out / "rows.jsonl"
    with told_by(parser):
        rows = run_jobs(first_pushes, jobs, rows_file, args.jobs, "first pushes", conditions=conditions)
    print(
        f"| kind | objects | out of sight | {' | '.join(METHODS)} | could, random | could, network | on part |"
    )
    print("|---" * (len(METHODS) + 6) + "|")
    groups = [(kind, [row for row in rows if row["kind"] == kind]) for kind in kinds]
    styles = sorted({(row["kind"], row["style"]) for row in rows if row.get("style")})
    groups += [
        (f"{kind}, {style}", [r for r in rows if (r["kind"], r.get("style")) == (kind, style)])
        for kind, style in styles
    ]
    for name, mine in [*groups, ("all", rows)]:
        seen = [row for row in mine if "network" in row]
        cells = [share([row[m] for row in seen if m in row]) for m in METHODS]
        if args.could:
            cells += [str(sum(row[m]["any"] for row in seen)) for m in ("random", "network")]
        else:
            cells += ["–", "–"]
        cells.append(str(sum(row["network"]["on_part"] for row in seen)))
        print(f"| {name} | {len(mine)} | {len(mine) - len(seen)} | {' | '.join(cells)} |")
    directions(groups)
    calibration([row for row in rows if "network" in row])


def directions(groups: list[tuple[str, list[dict[str, Any]]]]) -> None:
    """Which way the useful first pushes went; rows of earlier code do not tell."""
    head = "kind | by | objects | useful | the meant way | against it | grew / shrank | push to motion [°]"
    print(f"\n| {head} |\n{'|---' * 8}|")
    for (name, mine), method in product(groups, METHODS):
        results = [row[method] for row in mine if method in row]
        good = [one for one in results if one["useful"] and one.get("way_deg") is not None]
        if not results or len(good) < sum(one["useful"] for one in results):
            continue
        angles = [one["way_deg"] for one in good]
        meant, grew = sum(angle < RIGHT_WAY_DEG for angle in angles), sum(one["delta"] > 0 for one in good)
        spread = f"{np.median(angles):.0f} / {np.percentile(angles, 90):.0f}" if good else "–"
        cells = (wilson95(len(good), len(results)), wilson95(meant, len(results)), len(good) - meant)
        print(
            f"| {name} | {method} | {len(results)} | {cells[0]} | {cells[1]} | {cells[2]} |"
            f" {grew} / {len(good) - grew} | {spread} |"
        )


def calibration(rows: list[dict[str, Any]]) -> None:
    """What the network promised of its first pushes, and what came of them."""
    print("\n| promised | pushes | mean promise | useful |\n|---|---|---|---|")
    for low, high in pairwise((0.0, 0.5, 0.7, 0.8, 0.9, 1.01)):
        mine = [row for row in rows if low <= row["likelihood"] < high]
        if mine:
            promise = np.mean([row["likelihood"] for row in mine])
            kept = wilson95(sum(row["network"]["useful"] for row in mine), len(mine))
            print(f"| {low:.1f} to {min(high, 1.0):.1f} | {len(mine)} | {promise:.2f} | {kept} |")


if __name__ == "__main__":
    main()
