"""Is the stand-in's depth camera as noisy as a D415? Prints markdown tables and draws them; no budget is asserted.

    python tests/bench/bench_camera.py --out runs/camera

Planes at 0.5 to 2 m, square to the view or turned about the image's upright axis: of one light grey, with darker
squares, and with a nearly black middle (a picture of one grey is exposed until it is bright, however dark it is). Each
is seen by several cameras: a seed draws dot pattern, calibration's leftovers and noise. Noise is told on the middle
400x300 px, from the disparity that is linear in the pixel's coordinates and fits best. Spatial: root mean square of one
frame's distances from it; what is more than 1 px of disparity off is no noise but a wrong match, and counted as that.
Temporal: standard deviation of a pixel over the frames, median of the pixels. Waves: what stays of the mean frame,
smoothed over 31 px. Holes: pixels without a return.

Edges: a board 0.3 m, and an upright bar 15 mm wide 0.05 m, before a wall. Beside an edge: pixels of the wall that have
the near thing's depth, less pixels of the near thing that do not have it; and pixels of the wall without a return.

Range: the share of a plane that returns, from 0.26 to 0.34 m.

The figures of the D415 are those of its data sheet and of users: 0.05 to 0.10 px of noise on textured flats, 2 % at
2 m, waves of about 0.1 px, edges 5 to 7 px too fat, nearest f b / 126. No unit was measured here. Results are kept as
JSON lines; a run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import mujoco
import numpy as np
from refusals import told_by

from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.camera.intrinsics import StereoRig
from s2r_sim.world import CameraTruth

DISTANCES_M = (0.5, 0.75, 1.0, 1.5, 2.0)
PLANES = (("light", 0), ("light", 30), ("light", 60), ("squares", 0), ("dark", 0))  # surface, turned by [deg]
EDGES = {"board": 0.3, "bar": 0.05}  # before a wall so far behind [m]
NEAR_M = tuple(np.round(np.arange(0.26, 0.341, 0.01), 2).tolist())
SIGMA_D415_PX = (0.05, 0.10)
BOUND_D415 = (2.0, 0.02)  # distance [m], share of it
FATTENING_D415_PX = (5, 7)
DISPARITIES_D415 = 126

LIGHT, GREY, DARK = 0.8, 0.4, 0.04  # albedo
MIDDLE_PX = (400, 300)
SQUARE_PX = 100
BAR_M = 0.015
WRONG_PX = 1.0
BESIDE_PX = 60
SIDES = ("left", "right", "top", "bottom")
NOISE = (
    "spatial_px", "temporal_px", "spatial_mm", "temporal_mm", "waves_px", "off_mm", "holes", "wrong"
)  # fmt: skip
EDGE = ("fat", "most", "shadow")


def box(
    spec: mujoco.MjSpec,
    position: tuple[float, float, float],
    half: tuple[float, float],
    grey: float,
    turn: float = 0,
) -> None:
    """A thin board with its front at ``position``, turned about the world's z axis [deg]."""
    c, s = np.cos(np.deg2rad(turn) / 2), np.sin(np.deg2rad(turn) / 2)
    thick = 0.005
    body = spec.worldbody.add_body(pos=position, quat=[c, 0, 0, s])
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[thick, *half], pos=[thick, 0, 0], rgba=[grey, grey, grey, 1]
    )


def plane(distance_m: float, surface: str, turned_deg: float) -> mujoco.MjModel:
    """A plane that fills the view of a camera at the origin that looks along x; what is darker lies 0.05 mm on it."""
    spec, scale = mujoco.MjSpec(), distance_m / StereoRig().f_px
    box(spec, (distance_m, 0, 0), (6.0, 6.0), LIGHT, turned_deg)
    front = distance_m - 5e-5
    if surface == "dark":
        box(spec, (front, 0, 0), (scale * (MIDDLE_PX[0] / 2 + 20), scale * (MIDDLE_PX[1] / 2 + 20)), DARK)
    elif surface == "squares":
        for i, j in np.argwhere(np.indices((4, 3)).sum(axis=0) % 2 == 0):
            at = front, scale * SQUARE_PX * (i - 1.5), scale * SQUARE_PX * (j - 1.0)
            box(spec, at, (scale * SQUARE_PX / 2, scale * SQUARE_PX / 2), GREY)
    return spec.compile()


def before_a_wall(distance_m: float, thing: str) -> mujoco.MjModel:
    """A board of 240x160 px, or an upright bar, before a wall."""
    spec, scale = mujoco.MjSpec(), distance_m / StereoRig().f_px
    half = (BAR_M / 2 if thing == "bar" else 120 * scale, 80 * scale)
    box(spec, (distance_m, 0, 0), half, LIGHT)
    box(spec, (distance_m + EDGES[thing], 0, 0), (6.0, 6.0), GREY)
    return spec.compile()


def camera_of(model: mujoco.MjModel, seed: int) -> DepthCamera:
    """A camera at the origin that looks along x; hand and eye agree."""
    zero = (0.0, 0.0, 0.0)
    return DepthCamera(
        model,
        CameraTruth(
            position_m=zero,
            target_m=(1.0, 0.0, 0.0),
            roll_rad=0.0,
            hand_eye_m=zero,
            hand_eye_rad=zero,
            seed=seed,
        ),
    )


def measure(
    what: str, frames: int, distance_m: float, surface: str, turned_deg: float, seed: int
) -> dict[str, Any]:
    """One scene: "plane", "edge" (the surface is what stands before the wall) or "range"."""
    row = {"what": what, "distance_m": distance_m, "surface": surface, "turned_deg": turned_deg, "seed": seed}
    model = before_a_wall(distance_m, surface) if what == "edge" else plane(distance_m, surface, turned_deg)
    camera = camera_of(model, seed)
    nowhere = np.zeros(0)
    depth = np.stack([camera.capture(nowhere).depth_m for _ in range(frames)]).astype(np.float64)
    exact = camera.exact_depth(nowhere)
    if what == "plane":
        return row | noise(depth, exact, camera.rig)
    if what == "edge":
        return row | {"sides": edges(depth[0], exact, distance_m + EDGES[surface] / 2)}
    middle = depth[0][middle_of(exact)]
    good = np.abs(middle - distance_m) < 0.02 * distance_m
    return row | {"good": float(good.mean()), "wrong": float(((middle > 0) & ~good).mean())}


def middle_of(image: np.ndarray) -> np.ndarray:
    """The pixels in which noise is told."""
    (h, w), (wide, high) = image.shape, MIDDLE_PX
    mask = np.zeros((h, w), bool)
    mask[(h - high) // 2 : (h + high) // 2, (w - wide) // 2 : (w + wide) // 2] = True
    return mask


def noise(depth: np.ndarray, exact: np.ndarray, rig: StereoRig) -> dict[str, float]:
    """Noise of a plane in the middle of the picture.

    Args:
        depth: Frames [m], 0 without a return, shape (frames, height, width).
        exact: Without noise [m], shape (height, width).
        rig: Of the camera.
    """
    fb, mask = rig.f_px * rig.baseline_m, middle_of(exact)
    d = np.where(depth > 0, fb / np.where(depth > 0, depth, 1.0), np.nan)
    wrong = np.abs(d - fb / exact) > WRONG_PX
    good = mask & (depth[0] > 0) & ~wrong[0]
    always = mask & (depth > 0).all(axis=0) & ~wrong.any(axis=0)
    plane_d = fitted(d[0], good)
    waves = smoothed(d.mean(axis=0) - fitted(d.mean(axis=0), always), always)
    return {
        "spatial_px": float(np.sqrt(np.mean((d[0] - plane_d)[good] ** 2))),
        "temporal_px": float(np.median(d.std(axis=0, ddof=1)[always])),
        "spatial_mm": 1e3 * float(np.sqrt(np.mean((depth[0] - fb / plane_d)[good] ** 2))),
        "temporal_mm": 1e3 * float(np.median(depth.std(axis=0, ddof=1)[always])),
        "waves_px": float(np.abs(waves[always]).max()),
        "off_mm": 1e3 * float(np.median((depth[0] - exact)[good])),
        "holes": float((depth[0][mask] == 0).mean()),
        "wrong": float(wrong[0][mask].mean()),
    }


def fitted(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The linear function of the pixel's coordinates that fits the masked values best, shape as ``values``."""
    v, u = np.mgrid[: values.shape[0], : values.shape[1]]
    A = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3) / [*values.shape[::-1], 1.0]
    inside = mask.ravel()
    coefficients, *_ = np.linalg.lstsq(A[inside], values.ravel()[inside], rcond=None)
    return (A @ coefficients).reshape(values.shape)


def smoothed(values: np.ndarray, mask: np.ndarray, side: int = 31) -> np.ndarray:
    """Mean of the masked values in windows, 0 outside the mask."""
    weight = cv2.boxFilter(mask.astype(np.float64), -1, (side, side))
    mean = cv2.boxFilter(np.where(mask, values, 0.0), -1, (side, side)) / np.maximum(weight, 1e-9)
    return np.where(mask, mean, 0.0)


def edges(depth: np.ndarray, exact: np.ndarray, between_m: float) -> dict[str, dict[str, float]]:
    """What happens beside the edges of a near thing, over the rows (columns) that cross them well inside.

    Args:
        depth: One frame [m], shape (height, width).
        exact: Without noise [m].
        between_m: What is nearer is the near thing's.

    Returns:
        Per side: "fat" [px], by how much it is too large there, median, "most" [px], the 90th percentile, and
        "shadow" [px], pixels of the wall without a return, median.
    """
    near = exact < between_m
    rows, columns = (np.flatnonzero(near.any(axis=k)) for k in (1, 0))
    found = {}
    for side, image, true, across, wide in (
        ("left", depth, near, rows, columns),
        ("right", depth[:, ::-1], near[:, ::-1], rows, columns),
        ("top", depth.T, near.T, columns, rows),
        ("bottom", depth.T[:, ::-1], near.T[:, ::-1], columns, rows),
    ):
        inner = across[len(across) // 8 : len(across) - len(across) // 8]
        edge = int(np.argmax(true[inner[0]]))
        beside = slice(edge - BESIDE_PX, edge + min(BESIDE_PX, len(wide) // 2))
        got, is_near = image[inner, beside], true[inner, beside]
        as_near = (got > 0) & (got < between_m)
        fat = (as_near & ~is_near).sum(axis=1) - (~as_near & is_near).sum(axis=1)
        found[side] = {
            "fat": float(np.median(fat)),
            "most": float(np.percentile(fat, 90)),
            "shadow": float(np.median(((got == 0) & ~is_near).sum(axis=1))),
        }
    return found


def print_noise(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line per distance and surface, medians over the cameras; the lines as values."""
    rig, (bound_m, bound) = StereoRig(), BOUND_D415
    head = (
        "distance [m]", "surface", "σ_z spatial [mm]", "σ_z temporal [mm]", "D415 [mm]", "spatial [px]",
        "temporal [px]", "waves [px]", "off [mm]", "holes [%]", "wrong [%]",
    )  # fmt: skip
    print(f"| {' | '.join(head)} |")
    print("|---" * len(head) + "|")
    lines = []
    for scene in product(DISTANCES_M, PLANES):
        distance, (surface, turned) = scene
        mine = [row for row in rows if (row["distance_m"], (row["surface"], row["turned_deg"])) == scene]
        line: dict[str, Any] = {
            key: float(np.median([row[key] for row in mine])) for key in mine[0] if key in NOISE
        }
        line |= {"distance_m": distance, "name": f"{surface}, {turned}°"}
        low, high = (1e3 * distance**2 * s / (rig.f_px * rig.baseline_m) for s in SIGMA_D415_PX)
        print(
            f"| {distance:.2f} | {line['name']} | {line['spatial_mm']:.2f} | {line['temporal_mm']:.2f} |"
            f" {low:.1f} to {high:.1f} | {line['spatial_px']:.3f} | {line['temporal_px']:.3f} |"
            f" {line['waves_px']:.2f} | {line['off_mm']:+.2f} | {100 * line['holes']:.2f} | {100 * line['wrong']:.2f} |"
        )
        lines.append(line)
    square = [line for line in lines if line["name"] == "light, 0°" and line["distance_m"] == bound_m]
    share = square[0]["spatial_mm"] / 1e3 / bound_m
    print(
        f"\nat {bound_m:.0f} m: {100 * share:.2f} % of the distance (data sheet: at most {100 * bound:.0f} %)"
    )
    return lines


def print_edges(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line per distance and near thing, medians over the cameras; the lines as values."""
    fb = StereoRig().f_px * StereoRig().baseline_m
    print(
        f"\n| distance [m] | before the wall | too fat, {' / '.join(SIDES)} [px] | the same, 90th percentile |"
        " no return beside it [px] | hidden from the right imager [px] |\n|---|---|---|---|---|---|"
    )
    lines = []
    for distance, thing in product(DISTANCES_M, EDGES):
        mine = [row["sides"] for row in rows if (row["distance_m"], row["surface"]) == (distance, thing)]
        line = {
            side: {key: float(np.median([one[side][key] for one in mine])) for key in EDGE} for side in SIDES
        }
        # Far away a bar is a few pixels wide: what crosses its ends well inside says nothing.
        shown = SIDES if thing == "board" else SIDES[:2]
        cells = [" / ".join(f"{line[side][key]:z.0f}" for side in shown) for key in EDGE]
        hidden = fb / distance - fb / (distance + EDGES[thing])
        print(f"| {distance:.2f} | {thing} | {' | '.join(cells)} | {hidden:.0f}, on the left |")
        lines.append({"distance_m": distance, "thing": thing, "sides": line})
    low, high = FATTENING_D415_PX
    print(f"\n(D415: {low} to {high} px too fat; no return on the side away from the right imager)")
    return lines


def print_range(rows: list[dict[str, Any]]) -> None:
    """Share of good returns near the camera."""
    rig = StereoRig()
    print("\n| distance [m] | good returns [%] | wrong returns [%] |\n|---|---|---|")
    seen = []
    for distance in NEAR_M:
        mine = [row for row in rows if row["distance_m"] == distance]
        good, wrong = (float(np.median([row[key] for row in mine])) for key in ("good", "wrong"))
        seen += [distance] if good > 0.5 else []
        print(f"| {distance:.2f} | {100 * good:.1f} | {100 * wrong:.1f} |")
    nearest = rig.f_px * rig.baseline_m / DISPARITIES_D415
    print(
        f"\nnearest: {min(seen, default=float('nan')):.2f} m (D415: f b / {DISPARITIES_D415} = {nearest:.2f} m)"
    )


def draw(path: Path, planes: list[dict[str, Any]], sides: list[dict[str, Any]]) -> None:
    """Noise, holes and edges over distance, beside the figures of a D415."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    z = np.linspace(0.4, 2.1, 50)
    low, high = (1e3 * z**2 * s / (StereoRig().f_px * StereoRig().baseline_m) for s in SIGMA_D415_PX)
    figure, axes = plt.subplots(2, 2, figsize=(9, 6.4), layout="constrained")
    noise_ax, px_ax, holes_ax, edge_ax = axes.ravel()
    noise_ax.fill_between(z, low, high, color="0.85", label="D415, textured flats")
    px_ax.axhspan(*SIGMA_D415_PX, color="0.85", label="D415, textured flats")
    edge_ax.axhspan(*FATTENING_D415_PX, color="0.85", label="D415")
    square = [line for line in planes if line["name"] == "light, 0°"]
    for key, style in (("spatial", "o-"), ("temporal", "s--")):
        for ax, unit in ((noise_ax, "mm"), (px_ax, "px")):
            values = [line[f"{key}_{unit}"] for line in square]
            ax.plot([line["distance_m"] for line in square], values, style, label=f"simulated, {key}")
    for name in dict.fromkeys(line["name"] for line in planes):
        mine = [line for line in planes if line["name"] == name]
        values = [100 * line["holes"] for line in mine]
        holes_ax.plot([line["distance_m"] for line in mine], values, "o-", label=name)
    for thing, side in product(EDGES, ("left", "right")):
        mine = [line for line in sides if line["thing"] == thing]
        values, style = [line["sides"][side]["fat"] for line in mine], "o-" if thing == "board" else "s--"
        edge_ax.plot([line["distance_m"] for line in mine], values, style, label=f"{thing}, {side}")
    for ax, title, unit in (
        (noise_ax, "noise of a light plane square to the view", "σ_z [mm]"),
        (px_ax, "the same in disparity", "σ_d [px]"),
        (holes_ax, "pixels of a plane without a return", "[%]"),
        (edge_ax, "before a wall: too fat by", "[px]"),
    ):
        ax.set(title=title, xlabel="distance [m]", ylabel=unit)
        ax.grid(alpha=0.3)
        ax.legend(fontsize=7)
    for ax in (noise_ax, px_ax):
        ax.set_ylim(bottom=0.0)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def main() -> None:
    """Run, print and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cameras", type=int, default=2, help="per scene")
    parser.add_argument("--frames", type=int, default=4, help="per plane")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results and of camera.png")
    args = parser.parse_args()
    if args.frames < 2 or args.cameras < 1:
        parser.error(
            f"--frames {args.frames} --cameras {args.cameras}: noise in time takes 2 frames of a camera, ask for more"
        )
    jobs: list[tuple[Any, ...]] = []
    for seed in range(args.cameras):
        jobs += [("plane", args.frames, z, *surface, seed) for z, surface in product(DISTANCES_M, PLANES)]
        jobs += [("edge", 1, z, thing, 0, seed) for z, thing in product(DISTANCES_M, EDGES)]
        jobs += [("range", 1, z, "light", 0, seed) for z in NEAR_M]
    with told_by(parser):
        rows = run_jobs(measure, jobs, args.out / "rows.jsonl", args.jobs, "scenes")
    of = {what: [row for row in rows if row["what"] == what] for what in ("plane", "edge", "range")}
    planes, sides = print_noise(of["plane"]), print_edges(of["edge"])
    print_range(of["range"])
    draw(args.out / "camera.png", planes, sides)


if __name__ == "__main__":
    main()
