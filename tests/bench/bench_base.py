"""What stands beside a lever and is missing from the object's model, and what the model has that does not stand there.

    python tests/bench/bench_base.py --first 300 --count 40 --jobs 2 --out runs/base

The faucets of ``bench_levers.py``, seen by the stand-in's stereo camera before and after a turn. Joint and model as in
a run, neither arm nor contact. *Missed* are points that a camera saw on the true base, 12 mm and more above the table,
more than 10 mm from every piece of the modelled one: an arm that plans with it may run into them. *Filled* is volume
in the modelled base more than 12 mm from the true one: a fingertip is kept out of it for nothing.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from bench_levers import TOLD_RAD, drawn

from s2r_host.model.build import build_model
from s2r_host.model.errors import ModelError
from s2r_host.model.pieces import outside_m
from s2r_host.perception.errors import AbstainError
from s2r_host.perception.estimate import JointEstimate, estimate_joint
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.verdict import VAGUELY
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.faucet import FaucetSpec
from s2r_sim.objects.naming import BASE_BODY
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.scene import qpos_at, table_scene

MISSED_M, BESIDE_M, OF_BASE_M, ABOVE_M = 0.010, 0.012, 0.006, 0.012
SEEN_POINTS, VOLUME_POINTS = 3000, 4000
GROSS = 0.02  # of what was seen, from which on a model lacks a thing and not a rim
PROBE = "probe"


class TrueBase:
    """Distances to the base as it is: a tiny sphere is put where they are asked for."""

    def __init__(self, spec: FaucetSpec) -> None:
        scene = table_scene(spec)
        body = scene.worldbody.add_body(name=PROBE, mocap=True)
        body.add_geom(name=PROBE, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-4, 0.0, 0.0])
        self._model = scene.compile()
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = qpos_at(self._model, spec.q_start)
        mujoco.mj_kinematics(self._model, self._data)
        base = self._model.body(BASE_BODY).id
        self._geoms = np.flatnonzero(self._model.geom_bodyid == base)
        self._probe = self._model.geom(PROBE).id
        reach = self._model.geom_rbound[self._geoms][:, None]
        at = self._data.geom_xpos[self._geoms]
        self.low, self.high = (at - reach).min(axis=0), (at + reach).max(axis=0)
        self.low[2] = ABOVE_M

    def distance(self, p: np.ndarray) -> np.ndarray:
        """From points (n, 3) to the base's surface, negative inside [m], (n,)."""
        found = np.empty(len(p))
        for k, at in enumerate(p):
            self._data.mocap_pos[0] = at
            mujoco.mj_kinematics(self._model, self._data)
            found[k] = min(
                mujoco.mj_geomDistance(self._model, self._data, self._probe, int(geom), 0.2, None)
                for geom in self._geoms
            )
        return found


def job(number: int) -> dict[str, Any]:
    """One faucet."""
    spec, rng = drawn(number)
    row: dict[str, Any] = {"number": number, "style": spec.style}
    try:
        estimate = _told(spec, rng)
    except AbstainError as error:
        return row | {"untold": str(error)}
    with tempfile.TemporaryDirectory() as folder:
        try:
            pieces = build_model(estimate, Path(folder), seed=0).pieces
        except ModelError as error:
            return row | {"untold": str(error)}
    base, true = [piece for piece in pieces if piece.body == "base"], TrueBase(spec)
    chance = np.random.default_rng(number)
    seen = np.concatenate([estimate.view_before.points, estimate.view_after.points])
    seen = seen[(seen > true.low).all(axis=1) & (seen < true.high).all(axis=1)]
    seen = seen[chance.permutation(len(seen))[:SEEN_POINTS]]
    seen = seen[np.abs(true.distance(seen)) < OF_BASE_M]
    p = chance.uniform(true.low, true.high, (VOLUME_POINTS, 3))
    cm3 = 1e6 * float(np.prod(true.high - true.low)) / VOLUME_POINTS
    distance = true.distance(p)
    return row | {
        "pieces": len(base),
        "seen": len(seen),
        "missed": float((outside_m(seen, base) > MISSED_M).mean()),
        "filled_cm3": cm3 * int(((outside_m(p, base) < 0.0) & (distance > BESIDE_M)).sum()),
        "true_cm3": cm3 * int((distance < 0.0).sum()),
    }


def _told(spec: FaucetSpec, rng: np.random.Generator) -> JointEstimate:
    model = table_scene(spec).compile()
    placed = place_camera(rng, model, spec.q_start)[0]
    camera = DepthCamera(model, placed)
    turn = float(rng.uniform(*TOLD_RAD)) * (1.0 if spec.q_start < 0.5 * spec.q_max else -1.0)
    frames = []
    for q in (spec.q_start, float(np.clip(spec.q_start + turn, 0.0, spec.q_max))):
        view = camera.capture(qpos_at(model, q))
        frames.append(DepthFrame(view.depth_m, camera.rig.K, placed.X_base_camera_reported, view.colour))
    return estimate_joint(*frames, joint_type="revolute", known_to=VAGUELY)


def told(rows: list[dict[str, Any]]) -> list[str]:
    """The lines of the table."""
    good = [row for row in rows if "missed" in row]
    missed = 100.0 * np.array([row["missed"] for row in good])
    filled = np.array([row["filled_cm3"] for row in good])
    return [
        "| faucets | told | pieces | missed of what was seen, mean (worst) | 2 % or more | filled, mean [cm³] |",
        "|---|---|---|---|---|---|",
        f"| {len(rows)} | {len(good)} | {np.median([row['pieces'] for row in good]):.0f} "
        f"| {missed.mean():.1f} % ({missed.max():.1f} %) | {(missed >= 100.0 * GROSS).sum()} | {filled.mean():.0f} |",
    ]


def main() -> None:
    """Run it and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=300)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    jobs = [(k,) for k in range(arguments.first, arguments.first + arguments.count)]
    rows = run_jobs(job, jobs, arguments.out / "base.jsonl", arguments.jobs, "bases")
    text = "\n".join(told(rows)) + "\n"
    (arguments.out / "base.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
