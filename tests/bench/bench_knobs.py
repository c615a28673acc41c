"""Knobs with spokes: whether their outline is told from one view, and how exactly their turn and axis from two.

    python tests/bench/bench_knobs.py --count 60 --jobs 2 --out runs/knobs

Faucets with cross handles, drawn for this alone, seen by the stand-in's stereo camera with its noise and its hand-eye
error, before and after a turn of 8 to 35 degrees. What moves the handle is left out: no arm, no contact.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.motion.knobs import find_knobs, knob_deck
from s2r_host.motion.scene import observed_scene
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.knob_outline import fit_outline, turned_outline
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.faucet import FaucetSpec, draw_faucet
from s2r_sim.objects.naming import PART_BODY
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.scene import qpos_at, table_scene

STREAM = 20261125
TURN_RAD = np.radians((8.0, 35.0))
NEAR_M = 0.02  # of the true axis: the outline is that of the handle that turns, not of the other one


def drawn(number: int) -> tuple[FaucetSpec, np.random.Generator]:
    """A faucet with cross handles."""
    rng = np.random.default_rng([STREAM, number])
    while True:
        spec = draw_faucet(rng)
        if spec.spokes > 1:
            return spec, rng


def job(number: int) -> dict[str, Any]:
    """One faucet, seen twice."""
    spec, rng = drawn(number)
    model = table_scene(spec).compile()
    placed = place_camera(rng, model, spec.q_start)[0]
    camera = DepthCamera(model, placed)
    turn = float(rng.uniform(*TURN_RAD)) * (1.0 if spec.q_start < 0.5 * spec.q_max else -1.0)
    frames = []
    for q in (spec.q_start, float(np.clip(spec.q_start + turn, 0.0, spec.q_max))):
        view = camera.capture(qpos_at(model, q))
        frames.append(DepthFrame(view.depth_m, camera.rig.K, placed.X_base_camera_reported, view.colour))
        turn = q - spec.q_start
    row: dict[str, Any] = {
        "number": number,
        "spokes": spec.spokes,
        "round": spec.round_lever,
        "turn_rad": turn,
    }
    row["beyond_hub_m"] = spec.lever_m - spec.hub_radius_m
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    p_axis = data.xanchor[int(model.body(PART_BODY).jntadr[0])]
    scene = observed_scene(frames[0])
    for knob in find_knobs(scene):
        if np.linalg.norm(knob.p_axis[:2] - p_axis[:2]) > NEAR_M:
            continue
        row["found"] = True
        outline = fit_outline(frames[0], knob.p_axis, knob.reach_m, knob_deck(scene.p_base))
        if outline is None:
            continue
        row["outlined"] = True
        row["spokes_right"] = outline.spokes == spec.spokes
        row["axis_off_m"] = float(np.linalg.norm(outline.p_axis[:2] - p_axis[:2]))
        row["reach_off_m"] = outline.reach_m - spec.lever_m
        turned = turned_outline(outline, frames[1])
        if turned is not None:
            row["turn_off_rad"] = turned.angle - outline.angle - turn
    return row


def told(rows: list[dict[str, Any]], kind: str) -> str:
    """A line of the table."""

    def spread(name: str, factor: float) -> str:
        values = factor * np.abs([row[name] for row in rows if name in row])
        return (
            "–"
            if not len(values)
            else "{:.1f} ({:.1f}, {:.1f})".format(*np.percentile(values, [50, 90, 100]))
        )

    counts = [sum(name in row for row in rows) for name in ("found", "outlined", "turn_off_rad")]
    right = sum(row.get("spokes_right", False) for row in rows)
    spreads = [
        spread(*one)
        for one in (("axis_off_m", 1e3), ("reach_off_m", 1e3), ("turn_off_rad", float(np.degrees(1.0))))
    ]
    return " | ".join(["", kind, str(len(rows)), *(str(n) for n in counts), str(right), *spreads, ""]).strip()


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    numbers = [(number,) for number in range(arguments.first, arguments.first + arguments.count)]
    rows = run_jobs(job, numbers, arguments.out / "knobs.jsonl", arguments.jobs, "knobs")
    print(
        "| handle | n | seen apart | outlined | turn told | spokes right | axis off, mm | reach off, mm | turn off, ° |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for kind, some in (
        ("flat bars", [row for row in rows if not row["round"]]),
        ("rods", [row for row in rows if row["round"]]),
    ):
        print(told(some, kind))
    print(
        json.dumps({"turned wrongly": [r["number"] for r in rows if abs(r.get("turn_off_rad", 0.0)) > 0.05]})
    )


if __name__ == "__main__":
    main()
