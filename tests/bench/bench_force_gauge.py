"""The arm as a force gauge, against the sealed truth: effort felt at the object's joint, friction and mass learnt.

Reads the trials of a campaign (``s2r bench paper --out DIR``), whose runs left ``object-log/`` and ``run.json``::

    python tests/bench/bench_force_gauge.py DIR

What the joint truly took at a position and speed is computed from the world file: weight, Coulomb friction with its
hidden profile and stiction, damping and detents; inertia is left out, so rows that speed up are, too.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import mujoco
import numpy as np

from s2r_protocol.arms import load_arm
from s2r_sim.paper.score import sense
from s2r_sim.paper.trials import KINDS, Trial, draw_trial
from s2r_sim.physics import build_world
from s2r_sim.world import load_world


def taken(trial: Trial, model: mujoco.MjModel, s: np.ndarray, ds: np.ndarray) -> np.ndarray:
    """Effort that moves the part at joint values and speeds of the world, without acceleration, (n,)."""
    data, joint = mujoco.MjData(model), model.joint("object_joint")
    spec, effects = trial.world.object, trial.world.effects
    dry = spec.coulomb_N if trial.kind == "drawer" else spec.coulomb
    viscous = spec.damping_Ns_m if trial.kind == "drawer" else spec.damping
    efforts = []
    for value, speed in zip(s, ds, strict=True):
        data.qpos[joint.qposadr[0]] = value
        mujoco.mj_forward(model, data)
        friction = effects.friction(dry, float(value), abs(float(speed)))
        weight = float(data.qfrc_bias[joint.dofadr[0]]) - effects.detent_force(float(value))
        efforts.append(weight + np.sign(speed) * friction + viscous * speed)
    return np.array(efforts)


def judge(folder: Path) -> dict[str, float | str] | None:
    """Medians of one trial; None where nothing was felt."""
    kind, _, number = folder.name.partition("-")
    trial = draw_trial(kind, int(number))
    run_file = folder / "run/run.json"
    logs = sorted((folder / "run/object-log").glob("*.csv"))
    if not run_file.exists() or not logs:
        return None
    run = json.loads(run_file.read_text())
    sign = sense(trial.world, run)
    world = load_world(folder / "world.json")
    model = build_world(load_arm("xmate3pro"), world)
    errors, sizes = [], []
    for log in logs:
        table = np.genfromtxt(log, delimiter=",", skip_header=1)
        t, s, ds, effort = table.T
        steady = np.abs(np.gradient(ds, t))
        rows = (steady <= np.percentile(steady, 70)) & (np.abs(ds) > 0.1 * np.abs(ds).max())
        true = sign * taken(trial, model, world.object.q_start + sign * s[rows], sign * ds[rows])
        errors.append(effort[rows] - true)
        sizes.append(np.abs(true))
    error, size = np.concatenate(errors), np.concatenate(sizes)
    felt = run["joint"]["felt"] or {}
    spec = world.object
    dry = spec.coulomb_N if kind == "drawer" else spec.coulomb
    return {
        "trial": folder.name,
        "effort": float(np.median(size)),
        "error": float(np.median(np.abs(error)) / np.median(size)),
        "friction": felt.get("friction", np.nan) / dry,
        "mass": felt.get("mass_share", np.nan) * run["joint"]["mass_kg"] / spec.mass_kg,
        "guessed": run["joint"]["mass_kg"] / spec.mass_kg,
    }


def main() -> None:
    """Print a line per trial and medians per kind."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", type=Path, help="Folder of s2r bench paper.")
    campaign = parser.parse_args().campaign
    rows = [row for folder in sorted((campaign / "trials").iterdir()) if (row := judge(folder)) is not None]
    print("friction and mass over their true values; effort: median [N or N·m], error: its median share")
    for row in rows:
        print(
            f"{row['trial']:<12} effort {row['effort']:5.2f}  error {100 * row['error']:4.0f} %  "
            f"friction {row['friction']:5.2f}  mass {row['mass']:5.2f} (guessed {row['guessed']:5.2f})"
        )
    for kind in KINDS:
        mine = [row for row in rows if str(row["trial"]).startswith(kind)]
        if mine:
            error, friction, mass, guessed = (
                np.nanmedian([row[key] if key == "error" else abs(np.log(row[key])) for row in mine])
                for key in ("error", "friction", "mass", "guessed")
            )
            print(
                f"{kind:<8} n {len(mine)}: effort off by {100 * error:.0f} % (median), friction by a factor of "
                f"{np.exp(friction):.2f}, mass {np.exp(mass):.2f} (guessed {np.exp(guessed):.2f})"
            )


if __name__ == "__main__":
    main()
