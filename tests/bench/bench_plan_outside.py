"""The command `s2r plan` on scenes of others: `python tests/bench/bench_plan_outside.py --out DIR` prints a table.

Every task is run as a user would run it, in a process, and is judged by its exit code, by the words in its reason and
by the files it leaves; a plan's motion is stepped again by the verifier. What is done is in DIR/results.jsonl and is
not done again. The scenes with an arm in them are written into DIR.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from bench_plan_scenes import ARM, kept, motion_in

from s2r_host.planning import PlanRequest, PlanSettings
from s2r_host.planning.bench.verifier import verify
from s2r_host.planning.planner import scene_of

SCENES = Path(__file__).parent / "scenes_outside"
# Scene, joint, target, exit codes that are right, and words that a refusal has to have.
TASKS = (
    ("kitchen_drawers", "upper", "0.15", (0,), ""),
    ("kitchen_drawers", "lower", "0.2", (0,), ""),
    ("kitchen_drawers", "upper", "0.35", (4,), "beyond its range"),
    ("notebook_ref", "screen", "0.9", (4,), "overlaps"),
    ("notebook_ref", "screen", "-0.4", (0, 4), ""),
    ("odd_names", "joint1", "0.8", (0,), ""),
    ("odd_names", "Hot water / handle #2 (left)", "-0.8", (0,), ""),
    ("odd_names", "handle", "0.5", (2,), "no joint 'handle'"),
    ("door_and_latch", "latch", "0.5", (0, 4), ""),
    ("door_and_latch", "door", "-0.7", (0, 4), ""),
    ("door_and_latch", "swivel", "0.5", (2,), "neither a slide nor a hinge"),
    ("door_and_latch", "floating", "0.5", (2,), "neither a slide nor a hinge"),
    ("garage_door", "gate", "0.3", (0,), ""),
    ("garage_door", "gate", "500", (4,), "500"),
    ("tiny_switch", "slider", "0.005", (0, 4), ""),
    ("around_the_arm", "behind", "0.6", (0,), ""),
    ("around_the_arm", "overhead", "0.6", (0, 4), ""),
    ("around_the_arm", "far", "0.6", (4,), "out of reach"),
    ("around_the_arm", "below", "-0.6", (0,), ""),
    ("motorised", "servo", "0.1", (4,), "actuator"),
    ("motorised", "spring", "0.1", (4,), "spring"),
    ("motorised", "loose", "0.1", (0, 4), ""),
    ("inline_mesh_lid", "lid", "1.0", (0,), ""),
    ("ghost", "flap", "0.5", (2,), "moves"),
    ("ghost_fixed", "door", "0.5", (4,), "no solid geom"),
    ("broken", "x", "0.5", (2,), "broken.xml"),
    ("empty", "x", "0.5", (2,), "empty.xml"),
    ("missing_mesh", "door", "0.5", (2,), "nowhere.stl"),
    ("not_there", "door", "0.5", (2,), "no such file"),
    ("odd_names", "joint1", "nan", (4,), "not a finite number"),
    ("odd_names", "joint1", "inf", (4,), "not a finite number"),
    ("odd_names", "joint1", "ten", (2,), ""),
    ("with_arm", "tap", "0.6", (0,), ""),
    ("with_prefixed_arm", "tap", "0.6", (0,), ""),
    ("with_arm", "joint3", "0.6", (2,), "belongs to arm"),
    # Further habits: nested as in collections of objects, frames, replicate, attach, masks, couplings, units.
    ("robosuite_cabinet", "drawer_joint", "-0.15", (0,), ""),
    ("partnet_box", "joint_0", "-0.6", (0, 4), ""),
    ("framed", "crank", "0.6", (0,), ""),
    ("replicated", "lever_1", "0.6", (0,), ""),
    ("replicated", "lever", "0.6", (2,), "no joint 'lever'"),
    ("attached", "left/slide", "0.08", (0,), ""),
    ("scaled_mesh", "paddle", "0.6", (0,), ""),
    ("mimic", "left", "0.5", (0, 4), ""),
    ("limits_said", "said", "1.1", (0,), ""),
    ("limits_said", "said", "50", (4,), "beyond its range"),
    ("limits_said", "endless", "1.2", (0,), ""),
    ("limits_unsaid", "tap", "0.5", (2,), "limited"),
    ("y_up", "handle", "0.6", (0,), ""),
    ("menagerie_like", "door", "-0.8", (0,), ""),
    ("masks", "swing", "0.5", (0, 4), ""),
    ("unfixed", "drawer", "0.1", (0, 4), ""),
    ("centimetres", "door", "0.8", (4,), "out of reach"),
    ("as_urdf", "hinge", "0.8", (2,), "arm_base"),
    ("weightless", "Klappe größer", "0.6", (0,), ""),
    ("with_two_arms", "tap", "0.6", (2,), "keep one"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default="", help="tasks whose name holds this")
    parser.add_argument("--limit", type=float, default=120.0, help="time limit of a plan in seconds")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", UserWarning)  # MuJoCo's about attached scenes
    for name, prefixes in (
        ("with_arm", ("",)),
        ("with_prefixed_arm", ("robot/",)),
        ("with_two_arms", ("l/", "r/")),
    ):
        scene_with_arms(chosen.out / f"{name}.xml", prefixes)
    results = chosen.out / "results.jsonl"
    known = {row["task"]: row for row in kept(parser, results, {"--limit": chosen.limit})}
    for name, joint, target, codes, words in TASKS:
        task = f"{name} {joint} {target}"
        if chosen.only not in task:
            continue
        if task not in known:
            known[task] = {"task": task, **carried_out(name, joint, target, chosen.out, chosen.limit)}
            with results.open("a") as file:
                file.write(json.dumps(known[task]) + "\n")
        row = known[task]
        right = row["code"] in codes and words in row["reason"] and row["files"] and row["verified"]
        print(
            f"{'' if right else 'WRONG '}{task:48s} exit {row['code']}, {row['wall_s']:5.1f} s, "
            f"CPU {row['cpu_s']:5.1f} s  {row['legs'] or ''} {row['reason']}"[:400],
            flush=True,
        )


def carried_out(name: str, joint: str, target: str, out: Path, limit_s: float) -> dict[str, Any]:
    """One task as a user runs it."""
    scene = next(
        (p for p in (SCENES / f"{name}.xml", out / f"{name}.xml") if p.is_file()), SCENES / f"{name}.xml"
    )
    folder = out / "".join(c if c.isalnum() else "_" for c in f"{name}_{joint}_{target}")
    words = ["--scene", scene, "--joint", joint, "--target", target, "--out", folder, "--threads", "1"]
    started_s = time.perf_counter()
    ended = subprocess.run(
        [sys.executable, "-m", "s2r_protocol", "plan", *map(str, words), "--time-limit", f"{limit_s:g}", "--json"],
        capture_output=True, text=True, check=False, timeout=limit_s + 120.0,
    )  # fmt: skip
    wall_s = time.perf_counter() - started_s
    saved = folder / "plan.json"
    answer = json.loads(saved.read_text()) if saved.is_file() else {}
    planned = ended.returncode == 0
    files = ("plan.csv", "knots.csv", "trace.csv", "strip.png", "model/scene.xml")
    row = {
        "code": ended.returncode,
        "wall_s": wall_s,
        "cpu_s": answer.get("cpu_s", 0.0),
        "reason": answer.get("fragile") or "planned" if planned else answer.get("reason", ended.stderr),
        "files": all((folder / file).exists() == planned for file in files),
        "legs": len(answer["legs"]) if planned else 0,
        "verified": ended.stdout == (saved.read_text() if saved.is_file() else ""),
    }
    if "Traceback" in ended.stderr:
        row["reason"], row["verified"] = ended.stderr[-300:], False
    if planned:
        request = PlanRequest(
            ARM, scene, answer["s_initial"], answer["target"], ARM.q_home, joint, in_scene=True,
            settings=PlanSettings(threads=1),
        )  # fmt: skip
        row["verified"] &= bool(verify(motion_in(folder), request, scene_of(request)).good)
    return row


def scene_with_arms(path: Path, prefixes: tuple[str, ...]) -> None:
    """A tap on a bench and the arm itself, turned by 90 degrees, with a key frame and a motor of its own."""
    spec = mujoco.MjSpec.from_string("""<mujoco><compiler angle="radian"/><worldbody>
      <geom type="box" size=".5 .8 .05" pos=".6 .4 -.05"/><body pos=".3 .6 0">
      <geom type="cylinder" size=".02 .1" pos="0 0 .1"/><body pos="0 0 .22">
      <joint name="tap" axis="0 0 1" range="-1.4 1.4" damping=".2" frictionloss=".2"/>
      <geom type="capsule" size=".009" fromto="0 -.02 0 0 -.12 0" mass=".2"/></body></body></worldbody></mujoco>""")
    for row, prefix in enumerate(prefixes):
        arm = mujoco.MjSpec.from_string(ARM.mjcf)
        for key in list(arm.keys):
            arm.delete(key)
        frame = spec.worldbody.add_frame(pos=[0.3 - 1.5 * row, 0.0, 0.0], euler=[0, 0, np.pi / 2])
        spec.attach(arm, prefix=prefix, frame=frame)
        for name in ARM.joint_names:
            motor = spec.add_actuator(
                name=f"motor_{prefix}{name}", target=prefix + name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            motor.set_to_position(kp=100.0)
    model = spec.compile()
    spec.add_key(name="home", qpos=np.zeros(model.nq))
    spec.compile()
    path.write_text(spec.to_xml())


if __name__ == "__main__":
    main()
