"""Which physics left out changes where a planned motion leaves the part at all.

A motion is planned and timed with the believed model, then played with the same model plus one effect on the joint:
nothing else differs, neither perception nor the arm. The shift of the end is the most that knowing the effect could
gain. A fingertip is position control: what only asks for more force changes little.

    python tests/bench/bench_left_out.py --out left-out.json

``s2r bench missing`` plays the sealed effect of each of its objects in the same way, along what the arm really did. Of
a campaign of earlier code whose runs are still there that is told by

    python tests/bench/bench_left_out.py --runs DIR --out shifts.json
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from s2r_host.object_names import JOINT
from s2r_host.planning import PlanRequest, PlanSettings, plan_manipulation
from s2r_host.planning.planner import scene_of
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf, faucet_mjcf, lid_mjcf
from s2r_host.planning.scene import GeomKind, Scene
from s2r_host.planning.task import PlanRefusedError
from s2r_host.trajectory import Delivery, TimeLawSettings, deliver
from s2r_host.trajectory.verify import servo_targets
from s2r_protocol.arms import load_arm
from s2r_sim.missing.cases import LATER, LEARNING, draw_case
from s2r_sim.missing.play import Force, no_effect, played
from s2r_sim.missing.shift import largest, shifts
from s2r_sim.missing.trial import run_folder

STRIBECK = {"drawer": 0.02, "lid": 0.1, "faucet": 0.1}
PITCH = {"drawer": 0.03, "lid": 0.2, "faucet": 0.17}


def effects(kind: str) -> dict[str, Force]:
    """By name; strengths in units of the believed dry friction."""
    slow, pitch = STRIBECK[kind], PITCH[kind]

    def notch(size: float) -> Force:
        return lambda s, v, f: (-size * f * math.sin(2.0 * math.pi * s / pitch), f)

    return {
        "nothing": no_effect,
        "friction x 0.4": lambda s, v, f: (0.0, 0.4 * f),
        "friction x 2.5": lambda s, v, f: (0.0, 2.5 * f),
        "stiction + 100 %": lambda s, v, f: (0.0, f * (1.0 + math.exp(-((v / slow) ** 2)))),
        "profile 1 to 3": lambda s, v, f: (0.0, f * (2.0 + math.sin(2.0 * math.pi * s / (4.0 * pitch)))),
        "profile 0.1 to 1": lambda s, v, f: (
            0.0,
            f * (0.55 + 0.45 * math.sin(2.0 * math.pi * s / (4.0 * pitch))),
        ),
        "detent 0.7": notch(0.7),
        "detent 2": notch(2.0),
        "pull back 0.6": lambda s, v, f: (-0.6 * f, f),
        "pull back 0.95": lambda s, v, f: (-0.95 * f, f),
        "pull out 0.95": lambda s, v, f: (0.95 * f, f),
        "pull back 1.3": lambda s, v, f: (-1.3 * f, f),
    }


def cases() -> list[tuple[str, str, str, float, float]]:
    """Label, kind, object file, start, target."""
    heavy = drawer_mjcf(DrawerShape(mass=3.0, damping=5.0, friction=2.0))
    light = drawer_mjcf(DrawerShape(mass=1.2, damping=10.0, friction=4.0))
    found = [
        ("heavy drawer out", "drawer", heavy, 0.0, 0.10),
        ("heavy drawer in", "drawer", heavy, 0.08, 0.02),
        ("light drawer out", "drawer", light, 0.0, 0.08),
        ("light drawer in", "drawer", light, 0.08, 0.02),
        ("lid open", "lid", lid_mjcf(), 0.0, 0.4),
        ("lid close", "lid", lid_mjcf(), 0.0, -0.4),
        ("lever +", "faucet", faucet_mjcf(), 0.0, 0.4),
        ("lever -", "faucet", faucet_mjcf(), 0.0, -0.4),
    ]
    return found


def ends(delivery: Delivery, request: PlanRequest, scene: Scene, force: Force) -> float:
    """Where the part ends with an effect on its joint."""
    data = mujoco.MjData(scene.fine)
    data.qpos[: scene.dof] = request.q_initial
    data.qpos[scene.s_qpos] = request.s_initial
    _, control, _ = servo_targets(delivery.trajectory, request)

    def servo(data: mujoco.MjData, row: np.ndarray) -> None:
        data.ctrl[:] = row

    return played(scene.fine, data, JOINT, scene.geom_kind >= GeomKind.ROBOT, control, servo, force)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--runs", type=Path, help="the folder of a campaign: play its objects' own effects")
    args = parser.parse_args()
    rows = planned_ones() if args.runs is None else sealed_ones(args.runs)
    args.out.write_text(json.dumps(rows, indent=1) + "\n")


def sealed_ones(campaign: Path) -> list[dict[str, Any]]:
    """The shifts of every object of a campaign that was run without learning, by its own sealed effect."""
    rows = []
    for line in (campaign / "results.jsonl").read_text().splitlines():
        label, number, way, later = json.loads(line)["job"]
        if way != "as it is":
            continue
        folder = run_folder(campaign, label, number, way)
        found = shifts(draw_case(label, number), folder, (*LEARNING, *LATER[:later]))
        rows.append({"case": label, "number": number, "shifts": found, "shift_r": largest(found)})
        told = "nothing acts along the joint" if found is None else ", ".join(f"{x:+.2%}" for x in found)
        print(f"{label:<38} {number:>4}  {told}", flush=True)
    return rows


def planned_ones() -> list[dict[str, Any]]:
    """The shifts of motions planned here, by each of the effects."""
    arm, rows = load_arm("xmate3pro"), []
    with tempfile.TemporaryDirectory() as folder:
        for label, kind, text, start, target in cases():
            path = Path(folder) / "object.xml"
            path.write_text(text)
            for seed in range(4):
                request = PlanRequest(
                    arm, path, start, target, arm.q_home, seed=seed, settings=PlanSettings()
                )
                try:
                    result = plan_manipulation(request)
                    delivery = deliver(request, result, TimeLawSettings(speed=0.6), accept_fragile=True)
                    break
                except PlanRefusedError as error:
                    print(f"{label}: {error}", flush=True)
            else:
                continue
            scene = scene_of(request)
            plain = None
            for name, force in effects(kind).items():
                end = ends(delivery, request, scene, force)
                plain = end if plain is None else plain
                row = {"case": label, "effect": name, "end": end, "shift_r": (end - plain) / (target - start)}
                rows.append(row)
                print(
                    f"{label:<18} {name:<18} ends {end:+.4f}, shifted {100 * row['shift_r']:+6.1f} %",
                    flush=True,
                )
    return rows


if __name__ == "__main__":
    main()
