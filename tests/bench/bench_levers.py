"""Levers told by the outline of a solid, against depth alone and depth with edges of colour, in the same looks.

    python tests/bench/bench_levers.py --count 60 --jobs 2 --out runs/levers

Faucets with one lever, drawn for this alone, seen by the stand-in's stereo camera with its noise and its hand-eye
error: before and after a turn of 12 to 35 degrees, which tell the joint, and in a third look, in which it is measured.
What moves the lever is left out: no arm, no contact. All ways begin with the same joint, told by depth; what joint,
model and measurement come to is told for all levers, and for those whose outline was told.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np

from s2r_host.errors import SceneError
from s2r_host.model.errors import ModelError
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.estimate import JointEstimate, estimate_joint
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import line_distance
from s2r_host.perception.verdict import VAGUELY
from s2r_host.run.belief import build_belief
from s2r_host.run.measure_view import measure_in
from s2r_host.run.observe import Observation
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.faucet import FaucetSpec, draw_faucet
from s2r_sim.objects.naming import PART_BODY
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.scene import qpos_at, table_scene

STREAM = 20261126
TOLD_RAD, LATER_RAD = np.radians((12.0, 35.0)), np.radians((8.0, 40.0))
EXPECTED_RAD = np.radians(3.0)  # by which a plan's outcome is off
WAYS = ("depth", "depth and colour", "outline")


def drawn(number: int) -> tuple[FaucetSpec, np.random.Generator]:
    """A faucet with a lever."""
    rng = np.random.default_rng([STREAM, number])
    while True:
        spec = draw_faucet(rng)
        if spec.spokes == 1:
            return spec, rng


def job(number: int) -> dict[str, Any]:
    """One faucet, seen three times."""
    spec, rng = drawn(number)
    model = table_scene(spec).compile()
    placed = place_camera(rng, model, spec.q_start)[0]
    camera = DepthCamera(model, placed)
    q = [spec.q_start]
    for span in (TOLD_RAD, LATER_RAD):
        turn = float(rng.uniform(*span)) * (1.0 if q[-1] < 0.5 * spec.q_max else -1.0)
        q.append(float(np.clip(q[-1] + turn, 0.0, spec.q_max)))
    frames = []
    for one in q:
        view = camera.capture(qpos_at(model, one))
        frames.append(DepthFrame(view.depth_m, camera.rig.K, placed.X_base_camera_reported, view.colour))
    row: dict[str, Any] = {"number": number, "rod": spec.round_lever, "tilt_rad": spec.tilt_rad}
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    joint = int(model.body(PART_BODY).jntadr[0])
    try:
        estimate = estimate_joint(*frames[:2], joint_type="revolute", known_to=VAGUELY)
    except AbstainError as error:
        return row | {"untold": str(error)}
    row["outlined"] = estimate.lever is not None
    by_depth = _by_depth(estimate)
    guess = float(rng.normal(0.0, EXPECTED_RAD))
    for way, one in zip(WAYS, (by_depth, by_depth, estimate), strict=True):
        sense = float(np.sign(one.axis_direction @ data.xaxis[joint]))
        turned, later = sense * (q[1] - q[0]), sense * (q[2] - q[1])
        row[way] = {
            "turn_off_rad": one.delta - turned,
            "axis_off_rad": float(np.arccos(min(1.0, abs(float(one.axis_direction @ data.xaxis[joint]))))),
            "hinge_off_m": float(
                line_distance(data.xanchor[joint], data.xaxis[joint], one.axis_origin_m[None])[0]
            ),
            **_measured(one, frames[2], later, guess, colour=way != WAYS[0]),
        }
        if one.lever is not None and not (one.lever.rod or spec.round_lever):
            true = np.sort([spec.lever_width_m, spec.lever_thick_m])
            row[way]["size_off_m"] = (2.0 * np.sort(one.lever.half_m) - true).tolist()
    return row


def _by_depth(estimate: JointEstimate) -> JointEstimate:
    """The same without what an outline told."""
    if estimate.lever is None:
        return estimate
    motion = estimate.hypotheses[0].motion
    along = (estimate.axis_origin_m - motion.origin) @ motion.direction
    return replace(
        estimate,
        axis_origin_m=motion.origin + along * motion.direction,
        axis_direction=motion.direction,
        delta=motion.delta,
        lever=None,
    )


def _measured(
    estimate: JointEstimate, frame: DepthFrame, turned: float, guess: float, *, colour: bool
) -> dict[str, Any]:
    """The error of the measured turn since the second look."""
    if not colour:
        frame = replace(frame, colour=None)
    look = SimpleNamespace(capture=SimpleNamespace(frame=frame), arm_mask=np.zeros(frame.depth_m.shape, bool))
    with tempfile.TemporaryDirectory() as folder:
        try:
            belief = build_belief(estimate, Path(folder), 0)
            measured = measure_in(
                belief, cast(Observation, look), estimate.delta + turned + guess, since_told=True
            )
        except (ModelError, SceneError) as error:
            return {"unmeasured": str(error)}
    return {"state_off_rad": measured.s - estimate.delta - turned, "state_sigma_rad": measured.sigma}


def told(rows: list[dict[str, Any]], kind: str) -> list[str]:
    """The lines of the table."""

    def spread(values: list[float], factor: float) -> str:
        off = factor * np.abs(values)
        return "{:.2f} ({:.2f}, {:.2f})".format(*np.percentile(off, [50, 90, 100])) if len(off) else "–"

    lines = []
    for way in WAYS:
        columns = [
            spread([row[way][name] for row in rows if name in row[way]], factor)
            for name, factor in (
                ("turn_off_rad", float(np.degrees(1.0))),
                ("hinge_off_m", 1e3),
                ("axis_off_rad", float(np.degrees(1.0))),
                ("state_off_rad", float(np.degrees(1.0))),
            )
        ]
        beyond = sum(abs(row[way].get("state_off_rad", 0.0)) > np.radians(2.0) for row in rows)
        sizes = [size for row in rows for size in row[way].get("size_off_m", [])]
        columns += [str(beyond), str(sum("unmeasured" in row[way] for row in rows)), spread(sizes, 1e3)]
        lines.append(" | ".join(["", kind, way, str(len(rows)), *columns, ""]).strip())
    return lines


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
    rows = run_jobs(job, numbers, arguments.out / "levers.jsonl", arguments.jobs, "levers")
    known = [row for row in rows if "untold" not in row]
    print(f"{len(rows)} levers, of {len(known)} the joint was told; median (90 %, most):\n")
    head = ["levers", "by", "n", "turn off, °", "hinge off, mm", "axis off, °", "state off, °", "beyond 2°"]
    head += ["unseen", "width and thickness off, mm"]
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for kind, some in (("all", known), ("outlined", [row for row in known if row["outlined"]])):
        print("\n".join(told(some, kind)))


if __name__ == "__main__":
    main()
