"""The recorder under SIGKILL: how much of a 1 kHz recording is lost, over many random moments.

    python tests/bench/bench_recorder_crash.py --runs 20 --seconds 60

Each run feeds a recorder in real time and kills its writing process at a random moment, then recovers the file.
Budget: never more than 0.5 s lost. Runs are started together in groups, so that 20 minutes become a few.
"""

from __future__ import annotations

import argparse
import os
import signal
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from s2r_executor.config import RecorderConfig
from s2r_executor.observations import Encoder, Timeline
from s2r_executor.recorder import PlanIdentity, Recorder
from s2r_host.log.recover import recover
from s2r_host.log.tables import read_recording
from s2r_protocol.arms import load_arm
from s2r_protocol.faults import ExecutorState

BUDGET_S = 0.5
OFFSET_NS = 1_700_000_000_000_000_000
ARM = load_arm("xmate3pro")
RECORD = np.dtype(
    [("tick", "<u8"), ("stamp_ns", "<i8"), ("state", "<u4"), ("cause", "<u4"), ("plan_id", "<u8")]
    + [("plan_t", "<f8"), ("speed_scale", "<f8")]
    + [(name, "<f8", (7,)) for name in ("q_ref", "dq_ref", "q_meas", "dq_meas", "tau_meas")]
)
EVENT = np.dtype([("tick", "<u8"), ("stamp_ns", "<i8"), ("kind", "<u4"), ("state", "<u4")])


def one_run(folder: Path, kill_after_s: float, seed: int) -> tuple[float, float, float]:
    """(lost [s], recovered [s], slowest feed [s])."""
    timeline = Timeline(OFFSET_NS, 1_000_000, stepped=True)
    recorder = Recorder(folder, ARM, "/lab/xmate3pro", Encoder(ARM, timeline), RecorderConfig(), {})
    while recorder.session_path is None:
        time.sleep(0.01)
    recorder.open_plan(PlanIdentity(1, 1, 1, "bench", "bench"), b"")
    rng = np.random.default_rng(seed)
    begin, tick, slowest = time.monotonic(), 0, 0.0
    while (now := time.monotonic() - begin) < kill_after_s:
        count = int(now * 1000) - tick
        rows = np.zeros(count, RECORD)
        rows["tick"] = np.arange(tick, tick + count)
        rows["state"], rows["plan_id"] = ExecutorState.RUN, 1
        rows["q_meas"] = rng.standard_normal((count, 7))
        tick += count
        fed = time.perf_counter()
        recorder.feed(rows, np.zeros(0, EVENT), "bench")
        slowest = max(slowest, time.perf_counter() - fed)
        time.sleep(0.004)
    os.kill(recorder.writer_pid, signal.SIGKILL)
    saved = recover(folder / "plan-1-1.mcap", folder / "recovered.mcap")
    stamps = read_recording(saved.path).joints().stamp_ns
    assert (np.diff(stamps) == 1_000_000).all(), "a hole inside what was recovered"
    last = (int(stamps[-1]) - OFFSET_NS) / 1e9
    recorder.close()
    return tick / 1000 - last, last, slowest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--together", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    moments = np.random.default_rng(options.seed).uniform(0.5, options.seconds, options.runs)
    results: dict[int, tuple[float, float, float]] = {}
    with tempfile.TemporaryDirectory() as root:
        for first in range(0, options.runs, options.together):
            group = range(first, min(first + options.together, options.runs))
            threads = [
                threading.Thread(
                    target=lambda k=k: results.update({k: one_run(Path(root) / str(k), moments[k], k)})
                )
                for k in group
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            for k in group:
                lost, kept, slowest = results[k]
                print(f"run {k + 1:2d}: killed at {moments[k]:6.2f} s, recovered {kept:6.2f} s, lost {lost:.3f} s, "
                      f"slowest feed {1e3 * slowest:.2f} ms", flush=True)  # fmt: skip
    lost = np.array([results[k][0] for k in sorted(results)])
    print(f"lost: p50 {np.median(lost):.3f} s, p99 {np.quantile(lost, 0.99):.3f} s, worst {lost.max():.3f} s; "
          f"budget {BUDGET_S} s kept in {(lost <= BUDGET_S).sum()} of {len(lost)} runs")  # fmt: skip


if __name__ == "__main__":
    main()
