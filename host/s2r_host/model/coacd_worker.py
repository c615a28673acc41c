"""Child process of `decompose`: reads vertices and faces, writes one corner set per convex piece."""

from __future__ import annotations

import signal
import sys

import numpy as np


def main() -> None:
    """``python -m s2r_host.model.coacd_worker IN.npz OUT.npz CPU_SECONDS``; beyond those it ends by SIGPROF."""
    import coacd

    coacd.set_log_level("error")
    source, target, cpu_limit_s = sys.argv[1:4]
    signal.setitimer(signal.ITIMER_PROF, float(cpu_limit_s))  # unhandled, SIGPROF ends the process
    with np.load(source) as content:
        mesh = coacd.Mesh(content["vertices"], content["faces"])
    parts = coacd.run_coacd(
        mesh, threshold=0.1, preprocess_resolution=30, mcts_iterations=60, max_convex_hull=8, seed=0
    )
    arrays = {f"piece{i}": np.asarray(vertices, dtype=np.float64) for i, (vertices, _) in enumerate(parts)}
    np.savez(target, **arrays)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
