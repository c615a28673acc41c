"""How many pushes until the lever of a faucet is pushed along the way it goes? Order only: arm and physics left out.

    python tests/bench/bench_lever_guesses.py --count 160 --jobs 2 --out runs/lever-guesses
    python tests/bench/bench_lever_guesses.py --count 100 --pushes 3000-3249 --fit --out runs/lever-fit

One noisy view per faucet, drawn like those of `s2r bench paper` but with numbers that nothing else is reported of.
--pushes adds views as `bench_affordance.py` draws them, of the validation split, where levers are near a stop as well.
The likeliest guess is pushed at its first proposal, reachable or not. A push that meets the lever along its way
(cosine above 0.5, at least 3 cm from the axis) ends the search, any other is taken to be held out by what it meets.
--fit prints the logits of what a lever looks like and of which way it goes (logistic regression, ridge 1), with the
network's beliefs and by shape alone, which `s2r_host.run.lever_looks` holds as constants.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from s2r_host.motion.lever_axes import level_axis, upright_axis
from s2r_host.motion.levers import levers_in
from s2r_host.motion.robot_mask import back_project
from s2r_host.motion.scene import observed_scene
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.network_pushes import shipped
from s2r_host.run.guess import Tried
from s2r_host.run.lever_guesses import GuessSettings, belief_about, lever_guesses
from s2r_host.run.lever_looks import lever_features, swing_features
from s2r_sim.batch import run_jobs
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.catalogue import KINDS
from s2r_sim.objects.naming import PART_BODY
from s2r_sim.objects.pairs import place_camera
from s2r_sim.objects.push_data import with_room
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split, split_rng
from s2r_sim.paper.trials import draw_trial

MOST = 6
OF_NETWORK = {"looks": [2, 4], "swings": [2]}  # of the features
ALONG, LEAST_RADIUS_M, ON_PART = 0.5, 0.03, 0.6


def search(number: int, views: str) -> dict[str, Any]:
    """Pushes until the lever is met, and what its pieces look like; ``views``: "trials" or "pushes"."""
    if views == "trials":
        world = draw_trial("faucet", number).world
        spec, placed = world.object, world.camera
        model = table_scene(spec).compile()
    else:
        rng = split_rng("faucet", Split.VALIDATION, number)
        spec = with_room(rng, KINDS["faucet"].draw(rng))
        model = table_scene(spec).compile()
        placed = place_camera(rng, model, spec.q_start)[0]
    camera = DepthCamera(model, placed)
    qpos = qpos_at(model, spec.q_start)
    view = camera.capture(qpos)
    frame = DepthFrame(view.depth_m, camera.rig.K, placed.X_base_camera_reported, view.colour)
    part = (camera.exact_sight(qpos).body == model.body(PART_BODY).id) & (view.depth_m > 0)
    seen = cKDTree(back_project(frame)[part].reshape(-1, 3)) if part.any() else cKDTree(np.full((1, 3), 9.0))
    scene, found = observed_scene(frame), shipped().affordance(frame, np.random.default_rng(number))
    data = model, qpos
    row: dict[str, Any] = {
        "number": number,
        "views": views,
        "style": spec.style,
        "pushes": None,
        "looks": [],
        "swings": [],
    }
    tried: list[Tried] = []
    for count in range(1, MOST + 1):
        guesses = lever_guesses(scene, found, GuessSettings(), tried)
        push = next((p for guess in guesses for p in guess.proposals), None)
        if push is None:
            break
        touched = push.p_contact + 0.015 * push.direction
        way, radius = _way(*data, touched)
        if seen.query(touched)[0] < 0.012 and abs(way @ push.direction) > ALONG and radius > LEAST_RADIUS_M:
            row["pushes"] = count
            break
        tried.append(Tried(push.p_contact, push.direction, held_out=True, moved=False))
    levers = levers_in(scene)
    beliefs = [belief_about(found, lever.p) for lever in levers]
    for k, lever in enumerate(levers):
        line = beliefs[k][1]
        on_part = bool((seen.query(lever.p)[0] < 1e-3).mean() > ON_PART)
        row["looks"].append((*lever_features(levers, k, [belief for belief, _ in beliefs]), on_part))
        if on_part:
            way, _ = _way(*data, lever.p_tip)
            level, upright = level_axis(lever).way(lever.p_tip), upright_axis(lever).way(lever.p_tip)
            swings = abs(way @ level) > abs(way @ upright)
            row["swings"].append((*swing_features(lever, line), bool(swings)))
    return row


def _way(model: Any, qpos: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, float]:
    """Direction (3,) in which a point of the part goes, and its distance from the axis [m]."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    joint = int(model.body(PART_BODY).jntadr[0])
    way = np.cross(data.xaxis[joint], p - data.xanchor[joint])
    radius = float(np.linalg.norm(way))
    return way / max(radius, 1e-9), radius


def fitted(rows: np.ndarray) -> np.ndarray:
    """Logits of logistic regression; the last column of the rows is the answer, the first is 1."""
    X, y = rows[:, 1:-1], rows[:, -1]
    middle, spread = X.mean(axis=0), X.std(axis=0) + 1e-9
    Z = np.column_stack([np.ones(len(X)), (X - middle) / spread])
    loss = minimize(
        lambda w: np.logaddexp(0.0, -(2 * y - 1) * (Z @ w)).sum() + (w[1:] ** 2).sum(), np.zeros(Z.shape[1])
    )
    slope = loss.x[1:] / spread
    return np.append(loss.x[0] - slope @ middle, slope)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=1000, help="number of the first faucet")
    parser.add_argument("--count", type=int, default=160, help="faucets")
    parser.add_argument("--pushes", help="FIRST-LAST of the push bench's validation views to add")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--fit", action="store_true", help="print the fitted logits as well")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    args = parser.parse_args()
    numbers = [(number, "trials") for number in range(args.first, args.first + args.count)]
    if args.pushes:
        first, _, last = args.pushes.partition("-")
        numbers += [(number, "pushes") for number in range(int(first), int(last) + 1)]
    rows = run_jobs(search, numbers, args.out / "rows.jsonl", args.jobs, "views")
    print("| handle | views | 1st push | by the 2nd | 3rd | 4th | 6th |\n|---|---|---|---|---|---|---|")
    for style in ("top", "side", "pair", "all"):
        mine = [row["pushes"] or MOST + 1 for row in rows if style in (row["style"], "all")]
        shares = " | ".join(f"{100 * np.mean(np.array(mine) <= k):.0f} %" for k in (1, 2, 3, 4, 6))
        print(f"| {style} | {len(mine)} | {shares} |")
    if args.fit:
        for name, of_network in OF_NETWORK.items():
            data = np.array([one for row in rows for one in row[name]], float)
            kept = [column for column in range(data.shape[1] - 1) if column not in of_network]
            by_shape = np.zeros(data.shape[1] - 1)
            by_shape[kept] = fitted(data[:, [*kept, -1]])
            print(name, fitted(data).round(2).tolist(), "by shape", by_shape.round(2).tolist())


if __name__ == "__main__":
    main()
