"""Is the push network's map sensible on a real cloud? Prints what it says of an open microwave and draws it; no budget
is asserted.

    python tests/bench/bench_affordance_real.py --out runs/affordance-real

Needs a real single-view stereo cloud of a microwave whose door stands open, stanford-iprl-lab/ao-grasp
(test_data/real/microwave_open.ply, no licence stated: nothing of it is part of this project), under
``$S2R_SHARED_DATA/ao_grasp``. It has points and colours in the camera's frame, already cut out, and no pose. Assumed:
the largest plane that looks up, the microwave's top, is level, its lowest points lie 20 mm above the table, and the
camera is a pinhole with about one pixel per point. The network never saw a microwave.

What is counted is told by planes fitted to the cloud: the two largest upright ones are the door, which faces the
camera, and the box's side, at which the door hangs. Reach is the way along the door from that edge, 0, to its free
edge, 1. Score: chance that a point of the door is scored above one of the rest (0.5 = nothing told). Line: angle
between the way on which a point of the door is believed to move and the one on which it does, about the edge. The
cloud is drawn again for every seed, and so are the network's proposals.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import open3d as o3d
from scipy.stats import rankdata

from s2r_host.perception.affordance import WEIGHTS, Affordance, PushNetworkRuntime
from s2r_host.perception.frames import DepthFrame, backproject, project
from s2r_host.perception.loading import load_frame

SHARED = Path(os.environ.get("S2R_SHARED_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
ABOVE_TABLE_M = 0.02
PLANE_M = 0.008  # a plane's points lie within this
ON_DOOR_M, RIM_M = 0.015, 0.045
LOOKS_UP = 0.7  # least cosine between the camera's own up and the normal of what is to be level
UPRIGHT = 0.1  # most cosine between an upright plane's normal and the direction up
HIGHEST = 0.1  # share of the points that counts as scored highest


@dataclass(frozen=True, eq=False)
class Plane:
    """Points ``p`` [m], shape (n, 3), with p · normal = offset_m; the normal looks at the camera."""

    normal: np.ndarray
    offset_m: float
    points: np.ndarray


@dataclass(frozen=True, eq=False)
class Door:
    """An upright plane that turns about one of its upright edges, base frame.

    Attributes:
        normal: Unit, towards the camera, shape (3,).
        offset_m: Of the plane.
        outwards: Unit, level, along the door away from its hinge, shape (3,).
        hinge_m, free_m: Where hinge and free edge lie along ``outwards``.
        low_m, high_m: Heights of its lower and upper edge.
    """

    normal: np.ndarray
    offset_m: float
    outwards: np.ndarray
    hinge_m: float
    free_m: float
    low_m: float
    high_m: float

    def reach(self, points: np.ndarray) -> np.ndarray:
        """0 at the hinge, 1 at the free edge, shape (n,)."""
        return (points @ self.outwards - self.hinge_m) / (self.free_m - self.hinge_m)

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Which points lie on the door, shape (n,); its free edge, which has a rim, may be thicker and further out."""
        reach, height = self.reach(points), points[:, 2]
        thick = ON_DOOR_M + RIM_M * np.clip(reach, 0.0, 1.0)
        inside = (reach > 0) & (reach < 1 + RIM_M / (self.free_m - self.hinge_m))
        inside &= (height > self.low_m - ON_DOOR_M) & (height < self.high_m + ON_DOOR_M)
        return inside & (np.abs(points @ self.normal - self.offset_m) < thick)


def planes_of(points: np.ndarray, eye: np.ndarray) -> Iterator[Plane]:
    """Planes of a cloud, the largest first, each without the points of those before."""
    o3d.utility.random.seed(0)
    rest = points
    while len(rest) > len(points) / 20:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(rest))
        (*normal, offset), index = cloud.segment_plane(PLANE_M, 3, 2000)
        n = np.array(normal) * np.sign(np.dot(normal, eye) + offset)
        yield Plane(n, -offset * np.sign(np.dot(normal, eye) + offset), rest[index])
        rest = np.delete(rest, index, axis=0)


def placed(frame: DepthFrame) -> DepthFrame:
    """The frame with a camera pose by which its largest plane that looks up is level and all is above the table."""
    points = points_of(frame)
    up = next(plane.normal for plane in planes_of(points, np.zeros(3)) if -plane.normal[1] > LOOKS_UP)
    right = np.cross(np.cross(up, [1.0, 0.0, 0.0]), up)
    right /= np.linalg.norm(right)
    X = np.eye(4)
    X[:3, :3] = np.stack([np.cross(up, right), -right, up])  # x away from the camera
    X[2, 3] = ABOVE_TABLE_M - float(np.percentile(points @ up, 0.5))
    return replace(frame, X_base_camera=X)


def points_of(frame: DepthFrame) -> np.ndarray:
    """Points of a depth image in the base frame [m], shape (n, 3)."""
    return backproject(frame.depth_m, frame.K, frame.X_base_camera)[frame.depth_m > 0]


def find_door(points: np.ndarray, eye: np.ndarray) -> Door:
    """The one of the two largest upright planes that faces the camera more; it hangs where the other one is nearer.

    Raises:
        ValueError: There are no two of them.
    """
    upright = [plane for plane in planes_of(points, eye) if abs(plane.normal[2]) < UPRIGHT][:2]
    if len(upright) < 2:
        raise ValueError(
            f"{len(upright)} upright planes in the cloud; a door and the side it hangs at make two"
        )
    facing = [float((eye - plane.points.mean(axis=0)) @ plane.normal) for plane in upright]
    door, side = upright if facing[0] > facing[1] else upright[::-1]
    normal = np.array([*door.normal[:2], 0.0]) / np.linalg.norm(door.normal[:2])
    along = np.cross([0.0, 0.0, 1.0], normal)
    outwards = along * np.sign((door.points.mean(axis=0) - side.points.mean(axis=0)) @ along)
    offset = float(np.median(door.points @ normal))
    # The side, where it is the larger plane, has taken the door's points next to the hinge.
    near = points[np.abs(points @ normal - offset) < PLANE_M]
    hinge, free = np.percentile(near @ outwards, [1, 99])
    low, high = np.percentile(door.points[:, 2], [1, 99])
    return Door(normal, offset, outwards, float(hinge), float(free), float(low), float(high))


def told_apart(score: np.ndarray, mask: np.ndarray) -> float:
    """Chance that one of the mask's scores is above one of the others (area under the ROC curve)."""
    ranks, inside = rankdata(score), int(mask.sum())
    return float((ranks[mask].sum() - inside * (inside + 1) / 2) / (inside * (len(mask) - inside)))


def judged(found: Affordance, door: Door) -> dict[str, float]:
    """What can be counted of the network's answer."""
    points = found.cloud.points
    on_door, reach = door.holds(points), door.reach(points)
    best = found.actionability >= np.quantile(found.actionability, 1 - HIGHEST)
    # Points of the door move on circles about the hinge: along its normal.
    line = np.degrees(np.arccos(np.clip(np.abs(found.line[on_door] @ door.normal), 0, 1)))
    places = np.array([push.point for push in found.proposals])
    ways = np.array([push.direction for push in found.proposals]) @ door.normal
    placed_on, first = door.holds(places), found.proposals[0]
    return {
        "points on the door [%]": 100 * float(on_door.mean()),
        "highest tenth on the door [%]": 100 * float(on_door[best].mean()),
        "highest tenth on its free half [%]": 100 * float((on_door & (reach > 0.5))[best].mean()),
        "actionability, door against rest": told_apart(found.actionability, on_door),
        "actionability, free half against hinge half": told_apart(
            found.actionability[on_door], reach[on_door] > 0.5
        ),
        "belongs to the part, door against rest": told_apart(found.part, on_door),
        "mean actionability of the door": float(found.actionability[on_door].mean()),
        "mean actionability of the rest": float(found.actionability[~on_door].mean()),
        "mean belief in the door": float(found.part[on_door].mean()),
        "mean belief in the rest": float(found.part[~on_door].mean()),
        "line of motion off, median on the door [°]": float(np.median(line)),
        "proposals on the door [%]": 100 * float(placed_on.mean()),
        "proposals on its free half [%]": 100 * float((placed_on & (door.reach(places) > 0.5)).mean()),
        "first push on the door [%]": 100 * float(placed_on[0]),
        "first push: reach": float(door.reach(places[:1])[0]),
        "first push: off the door's normal [°]": float(np.degrees(np.arccos(np.clip(-ways[0], -1, 1)))),
        "first push: likelihood": first.likelihood,
    }


def draw(path: Path, found: Affordance, frame: DepthFrame, door: Door) -> None:
    """What the camera sees with actionability and belief, and the proposals, there and from above."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    points = found.cloud.points
    (u, v) = project(points, frame.K, frame.X_base_camera)[0].T
    on_door = door.holds(points)
    figure, axes = plt.subplots(1, 4, figsize=(19, 4.6), layout="constrained")
    for ax, value, title in (
        (axes[0], found.actionability, "actionability"),
        (axes[1], found.part, "belongs to the part"),
        (axes[2], door.reach(points), "points of the door by the planes (colour: reach)"),
    ):
        shown = on_door if ax is axes[2] else np.ones(len(points), bool)
        ax.scatter(u[~shown], v[~shown], c="0.8", s=6)
        ax.scatter(u[shown], v[shown], c=value[shown], s=6, vmin=0, vmax=1, cmap="turbo")
        ax.set(aspect="equal", title=title)
        ax.invert_yaxis()
    for k, push in enumerate(found.proposals[::-1]):
        first = k == len(found.proposals) - 1
        tail, tip = push.point - 0.08 * push.direction, push.point
        (x, y) = project(np.stack([tail, tip]), frame.K, frame.X_base_camera)[0].T
        style = {"arrowstyle": "->", "color": "red" if first else "black", "lw": 2.5 if first else 0.4}
        axes[0].annotate("", (x[1], y[1]), (x[0], y[0]), arrowprops=style)
        axes[3].annotate("", (-tip[1], tip[0]), (-tail[1], tail[0]), arrowprops=style)
    axes[3].scatter(-points[:, 1], points[:, 0], c=found.actionability, s=6, vmin=0, vmax=1, cmap="turbo")
    axes[3].set(aspect="equal", title="from above: actionability and proposals, first in red")
    figure.savefig(path, dpi=70)
    plt.close(figure)


def main() -> None:
    """Judge, print and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cloud", type=Path, default=SHARED / "ao_grasp" / "microwave_open.ply", help="PLY")
    parser.add_argument(
        "--weights", type=Path, default=WEIGHTS, help="folder of the network [default: the shipped one]"
    )
    parser.add_argument("--seeds", type=int, default=10, help="how often cloud and proposals are drawn")
    parser.add_argument("--out", type=Path, required=True, help="folder of the picture")
    args = parser.parse_args()
    if not args.cloud.is_file():
        parser.error(f"--cloud {args.cloud}: no such file; get it from ao-grasp, or set S2R_SHARED_DATA")
    frame = load_frame(args.cloud, "camera")
    assert isinstance(frame, DepthFrame)
    frame = placed(frame)
    door = find_door(points_of(frame), frame.X_base_camera[:3, 3])
    runtime = PushNetworkRuntime(args.weights)
    answers = [runtime.affordance(frame, np.random.default_rng(seed)) for seed in range(args.seeds)]
    rows = [judged(answer, door) for answer in answers]
    print("| | median | least | most |\n|---|---|---|---|")
    for key in rows[0]:
        values = [row[key] for row in rows]
        print(f"| {key} | {np.median(values):.2f} | {min(values):.2f} | {max(values):.2f} |")
    hits = sum(row["first push on the door [%]"] > 0 for row in rows)
    print(f"\nfirst push on the door: {hits} of {len(rows)}")
    args.out.mkdir(parents=True, exist_ok=True)
    draw(args.out / "affordance-real.png", answers[0], frame, door)


if __name__ == "__main__":
    main()
