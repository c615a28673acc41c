"""How well and how fast is a joint followed from depth frames? Prints a markdown table; no budget is asserted.

    python tests/bench/bench_perception_track.py --count 5

Per object: the joint is estimated from one noisy pair, then the part moves on in small steps through the
whole range seen by the same camera; every frame is new noise. Times are CPU time of one thread per frame of
848x480.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from s2r_host.perception import AbstainError, DepthFrame, estimate_joint
from s2r_host.perception.track import JointTracker
from s2r_sim.camera.camera import DepthCamera
from s2r_sim.objects.catalogue import KINDS
from s2r_sim.objects.pairs import draw_pair, place_camera
from s2r_sim.objects.scene import qpos_at, table_scene
from s2r_sim.objects.splits import Split

FRAMES = 8


def follow(kind: str, seed: int) -> list[dict[str, Any]] | None:
    """One row per frame; None if no joint was found to follow."""
    pair = draw_pair(kind, Split.TEST, seed)
    before, after = (
        DepthFrame(d, pair.K, pair.X_base_camera, None) for d in (pair.depth_before, pair.depth_after)
    )
    try:
        estimate = estimate_joint(before, after)
    except AbstainError:
        return None
    sense = np.sign(pair.delta)
    model = table_scene(pair.spec).compile()
    truth, *_ = place_camera(np.random.default_rng(0), model, pair.spec.q_start)
    camera = _same_view(model, truth, pair.X_base_camera)
    low, high = sorted((pair.joint.q_start, pair.joint.q_start + pair.delta))
    margin = 0.3 * (high - low)
    path = np.linspace(max(0.0, low - margin), min(pair.joint.q_max, high + margin), FRAMES)
    tracker = JointTracker.of(estimate)
    rows = []
    for q in path:
        frame = DepthFrame(camera.capture(qpos_at(model, float(q))).depth_m, pair.K, pair.X_base_camera, None)
        start = time.thread_time()
        state = tracker.update(frame)
        rows.append(
            {
                "ms": 1e3 * (time.thread_time() - start),
                "error": None if state.value is None else state.value - sense * (q - pair.joint.q_start),
                "half": None if state.interval90 is None else (state.interval90[1] - state.interval90[0]) / 2,
            }
        )
    return rows


def _same_view(model: Any, truth: Any, X: np.ndarray) -> DepthCamera:
    """A camera at a given pose."""
    p, z = X[:3, 3], X[:3, 2]
    level = np.cross(z, [0.0, 0.0, 1.0])
    level /= np.linalg.norm(level)
    roll = float(np.arctan2(X[:3, 0] @ np.cross(z, level), X[:3, 0] @ level))
    placed = truth.model_copy(
        update={"position_m": tuple(p.tolist()), "target_m": tuple((p + z).tolist()), "roll_rad": roll}
    )
    camera = DepthCamera(model, placed)
    assert np.allclose(camera.X_base_camera, X, atol=1e-9)
    return camera


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="chest,laptop,faucet", help="comma-separated")
    parser.add_argument("--first", type=int, default=500, help="first seed")
    parser.add_argument("--count", type=int, default=5, help="objects per kind")
    args = parser.parse_args()
    print(
        "| kind | objects | not estimated | frames | lost | error p50 / p90 | in 90 % | CPU p50 / worst [ms] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for kind in args.kinds.split(","):
        followed = [follow(kind, seed) for seed in range(args.first, args.first + args.count)]
        rows = [row for sequence in followed if sequence is not None for row in sequence]
        found = [row for row in rows if row["error"] is not None]
        scale, unit = (1e3, "mm") if KINDS[kind].slides else (180 / np.pi, "°")
        error = scale * np.abs([row["error"] for row in found]) if found else np.full(1, np.nan)
        inside = [abs(row["error"]) < row["half"] for row in found]
        ms = [row["ms"] for row in rows] or [float("nan")]
        print(
            f"| {kind} | {len(followed)} | {sum(s is None for s in followed)} | {len(rows)} |"
            f" {len(rows) - len(found)} |"
            f" {np.percentile(error, 50):.2f} / {np.percentile(error, 90):.2f} {unit} | {100 * np.mean(inside):.0f} % |"
            f" {np.median(ms):.1f} / {max(ms):.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
