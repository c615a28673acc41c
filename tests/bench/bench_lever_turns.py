"""How exactly the turn of a lever is measured: by depth alone, and with its edges in colour.

    python tests/bench/bench_lever_turns.py --count 60 --jobs 2 --out runs/turns

Faucets with one lever, drawn for this alone, seen by the stand-in's stereo camera with its noise and its hand-eye
error, before and after a turn of 15 to 60 degrees. Which pixels of the first look are the lever's is taken from the
truth, as is the hinge but for an error drawn like those of joints that are told: this is about the turn alone. What
moves the lever is left out: no arm, no contact.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.errors import SceneError
from s2r_host.perception.colour_turn import Turn, combined, turn_by_colour
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.view import DepthView
from s2r_host.run.measure import PartTemplate, measure_state
from s2r_host.run.measure_view import DEPTH_ERRS_M
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.faucet import FaucetSpec, draw_faucet
from s2r_sim.objects.naming import PART_BODY
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.scene import joint_truth, qpos_at, table_scene

STREAM = 20261126
TURN_RAD = np.radians((15.0, 60.0))
HINGE_OFF_M, AXIS_OFF_RAD, EXPECTED_OFF_RAD = 0.001, np.radians(0.3), np.radians(2.0)  # standard deviations
STRAY_M = 0.01  # off the truth: depth of something else that a window saw as the lever's
ROOM_RAD = 0.3  # beyond the turn, in which it is looked for
TRIES = 100
FAR_RAD = np.radians(1.5)


def drawn(number: int) -> tuple[FaucetSpec, float, np.random.Generator]:
    """A faucet with one lever, and its turn [rad]."""
    rng = np.random.default_rng([STREAM, number])
    for _ in range(TRIES):
        spec = draw_faucet(rng)
        turn = float(rng.uniform(*TURN_RAD)) * (1.0 if spec.q_start < 0.5 * spec.q_max else -1.0)
        if spec.spokes == 1 and 0.0 <= spec.q_start + turn <= spec.q_max:
            return spec, turn, rng
    raise RuntimeError(f"faucet {number}: none of {TRIES} drawn has one lever and room for its turn")


def job(number: int) -> dict[str, Any]:
    """One faucet, seen twice."""
    spec, turn, rng = drawn(number)
    model = table_scene(spec).compile()
    placed = place_camera(rng, model, spec.q_start)[0]
    camera = DepthCamera(model, placed)
    views = []
    for q in (spec.q_start, spec.q_start + turn):
        seen = camera.capture(qpos_at(model, q))
        frame = DepthFrame(seen.depth_m, camera.rig.K, placed.X_base_camera_reported, seen.colour)
        views.append(DepthView(frame))
    before, after = views
    # The host believes another pose of its camera than the true one, and tells joints where it believes them.
    X_believed = placed.X_base_camera_reported @ np.linalg.inv(camera.X_base_camera)
    sight = camera.exact_sight(qpos_at(model, spec.q_start))
    of_part = (sight.body == model.body(PART_BODY).id).ravel()[before.flat]
    p_true = sight.point.reshape(-1, 3)[before.flat] @ X_believed[:3, :3].T + X_believed[:3, 3]
    part = of_part & (np.linalg.norm(before.points - p_true, axis=1) < STRAY_M)
    truth = joint_truth(model, spec)
    direction = X_believed[:3, :3] @ np.array(truth.direction) + AXIS_OFF_RAD * rng.normal(size=3)
    origin = X_believed[:3, :3] @ np.array(truth.origin_m) + X_believed[:3, 3]
    motion = JointMotion(
        "revolute",
        origin + HINGE_OFF_M * rng.normal(size=3),
        direction / np.linalg.norm(direction),
        turn + EXPECTED_OFF_RAD * float(rng.normal()),
    )
    keep = part & before.normal_ok & ~before.edge
    template = PartTemplate(
        before.points[keep], before.normals[keep], motion, before.points[~part & ~before.edge]
    )
    row: dict[str, Any] = {"turn_rad": turn, "reach_m": template.reach_m if keep.any() else None}
    try:
        span = (min(0.0, turn) - ROOM_RAD, max(0.0, turn) + ROOM_RAD)
        found = measure_state(template, after, span, motion.delta)
    except (SceneError, ValueError):
        return row  # hidden, or hardly any depth on it
    row["depth_off_rad"] = row["both_off_rad"] = found.s - turn
    colour = turn_by_colour(
        before, part, after, JointMotion("revolute", motion.origin, motion.direction, found.s)
    )
    if colour is not None:
        spread = found.sigma if np.isfinite(found.sigma) else 0.0
        depth = Turn(found.s, float(np.hypot(spread, DEPTH_ERRS_M / template.reach_m)))
        row["colour_off_rad"], row["both_off_rad"] = colour.delta - turn, combined(depth, colour).delta - turn
    return row


def told(rows: list[dict[str, Any]], name: str, words: str) -> str:
    """A line of the table."""
    off = np.abs([row[f"{name}_off_rad"] for row in rows if f"{name}_off_rad" in row])
    middle, high = np.degrees(np.percentile(off, [50, 90]))
    return f"| {words} | {len(off)} | {middle:.2f} | {high:.2f} | {int((off > FAR_RAD).sum())} |"


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
    rows = run_jobs(job, numbers, arguments.out / "turns.jsonl", arguments.jobs, "levers")
    print(
        f"{len(rows)} levers, {sum('depth_off_rad' not in row for row in rows)} of them not seen in the second look"
    )
    print("| measured by | looks | off in the median, ° | 90 %, ° | more than 1.5° |\n|---|---|---|---|---|")
    print(told(rows, "depth", "depth"))
    print(told(rows, "colour", "edges in colour"))
    print(told(rows, "both", "both"))


if __name__ == "__main__":
    main()
