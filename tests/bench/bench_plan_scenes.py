"""`s2r plan` on scenes as users write them: `python tests/bench/bench_plan_scenes.py --out DIR` prints a table.

The scenes in tests/bench/scenes are small pieces of furniture and fittings in as many ways of writing MJCF. What is
done is in DIR/results.jsonl and is not done again; the plans are in folders beside it. Every plan is judged by the
verifier, which steps the motion by itself.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from refusals import told_by

from s2r_host.planning import PlanRequest, PlanSettings
from s2r_host.planning.bench.verifier import verify
from s2r_host.planning.patience import Patience
from s2r_host.planning.planner import scene_of
from s2r_host.trajectory import Trajectory
from s2r_host.trajectory.plan_scene import PlanTask, plan_scene
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.conditions import keep_to
from s2r_protocol.exits import S2RError

ARM = load_arm("xmate3pro")
SCENES = Path(__file__).parent / "scenes"
TASKS = (
    ("oven", "flap", 1.3),
    ("oven", "flap", 1.45),
    ("door_bar", "hinge", -1.2),
    ("door_bar", "hinge", -1.7),
    ("valve_three_spokes", "wheel", 3.14),
    ("sliding_pane", "pane", 0.45),
    ("fridge", "upper", -1.1),
    ("microwave", "door", -1.4),
    ("dishwasher", "door", 1.2),
    ("tap_cross", "tap", 3.0),
    ("door_of_meshes", "door", -1.3),
    ("double_doors", "ldoor", -1.3),
    ("double_doors", "rdoor", 1.3),
    ("double_doors_coupled", "rdoor", 0.8),
    ("door_bar", "hinge", -0.5),
    ("door_knob", "hinge", -1.2),
    ("door_with_spring", "door", -1.0),
    ("door_on_turntable", "door", -0.6),
    ("fridge", "lower", -1.1),
    ("oven", "flap", 1.0),
    ("oven_light", "flap", 1.0),
    ("box_flap", "flap", 1.3),
    ("chest", "lid", 1.2),
    ("chest", "lid", 1.6),
    ("lid_with_bar", "lid", 1.9),
    ("laptop_closed", "lid", 0.6),
    ("laptop_open", "lid", 0.4),
    ("sliding_pane", "pane", 0.2),
    ("sliding_window", "sash", 0.4),
    ("drawer_stack", "drawer0", 0.2),
    ("drawer_stack", "drawer1", 0.25),
    ("drawer_stack", "drawer2", 0.28),
    ("valve", "wheel", 1.5),
    ("valve", "wheel", -1.57),
    ("valve_upright", "wheel", 1.5),
    ("tap", "lever", 1.5),
    ("tap", "lever", -1.5),
    ("tap_up_and_down", "lever", 0.5),
    ("tap_with_reference", "tap", 2.1),
    ("barrier", "barrier", -1.5),
    ("barrier", "barrier", 1.5),
    ("dial", "dial", 1.57),
    ("toggle", "switch", 0.5),
    ("pedal", "pedal", -0.4),
    ("millimetres", "door", -0.6),
    ("flap_hinged_above", "flap", 1.0),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default="", help="scenes whose name holds this")
    parser.add_argument("--limit", type=float, default=None, help="seconds per plan")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    results = chosen.out / "results.jsonl"
    before = kept(parser, results, {"--limit": chosen.limit})
    known = {(row["scene"], row["joint"], row["target"]): row for row in before}
    for task in TASKS:
        if chosen.only not in task[0]:
            continue
        if task not in known:
            name, joint, target = task
            known[task] = carried_out(SCENES / f"{name}.xml", joint, target, chosen.out, chosen.limit)
            with results.open("a") as file:
                file.write(json.dumps(known[task]) + "\n")
        print(line(known[task]), flush=True)


def kept(parser: argparse.ArgumentParser, results: Path, conditions: dict[str, Any]) -> list[dict[str, Any]]:
    """What is done already; a line that an interruption cut short is done again. Refuses other conditions."""
    text = results.read_text() if results.is_file() else ""
    rows = []
    for line_ in text.splitlines():
        try:
            rows.append(json.loads(line_))
        except ValueError:
            continue
    with told_by(parser):
        keep_to(conditions, results, begun=bool(rows))
    if text and not text.endswith("\n"):
        results.write_text(text + "\n")
    return rows


def carried_out(
    scene_file: Path, joint: str, target: float, out: Path, limit_s: float | None
) -> dict[str, Any]:
    """One task planned and verified."""
    name = scene_file.stem
    folder = out / f"{name}_{joint}_{target:g}"
    settings = PlanSettings(threads=1)
    row: dict[str, Any] = {"scene": name, "joint": joint, "target": target}
    cpu_s = time.process_time()
    try:
        task = PlanTask(scene_file, joint, target, ARM, folder, settings=settings)
        answer = plan_scene(task, Patience(limit_s))
    except S2RError as error:
        return {**row, "planned": False, "cpu_s": time.process_time() - cpu_s, "reason": str(error)}
    request = PlanRequest(
        ARM, scene_file, answer["s_initial"], target, ARM.q_home, joint, in_scene=True, settings=settings
    )
    verdict = verify(motion_in(folder), request, scene_of(request))
    return {
        **row,
        "planned": True,
        "verified": verdict.good,
        "contacts": verdict.contacts,
        "violations": verdict.violations,
        "legs": len(answer["legs"]),
        "duration_s": answer["duration_s"],
        "cpu_s": answer["cpu_s"],
        "fragile": answer["fragile"],
    }


def motion_in(folder: Path) -> Trajectory:
    """The delivered motion from its knots."""
    knots = np.loadtxt(folder / "knots.csv", delimiter=",", skiprows=1)
    q, dq, ddq = (knots[:, 1 + k * ARM.dof : 1 + (k + 1) * ARM.dof] for k in range(3))
    return Trajectory(knots[:, 0], q, dq, ddq)


def line(row: dict[str, Any]) -> str:
    """One row of the table."""
    head = f"{row['scene']:22s}{row['joint']:9s}{row['target']:+6.2f}  CPU {row['cpu_s']:5.1f} s  "
    if not row["planned"]:
        return head + f"refused: {row['reason']}"
    verified = "verified" if row["verified"] else f"NOT VERIFIED {row['contacts']} {row['violations']}"
    fragile = f"; {row['fragile']}" if row["fragile"] else ""
    return head + f"{row['legs']} legs, {row['duration_s']:.1f} s, {verified}{fragile}"


if __name__ == "__main__":
    main()
