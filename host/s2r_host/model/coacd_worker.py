"""Child process of `decompose`: reads vertices and faces, writes one corner set per convex piece."""

from __future__ import annotations

import json
import signal
import sys

import numpy as np


def main() -> None:
    """``python -m s2r_host.model.coacd_worker IN.npz OUT.npz CPU_SECONDS OPTIONS``; options: JSON, of CoACD.

    Beyond its processor time it ends by SIGPROF.
    """
    import coacd

    coacd.set_log_level("error")
    source, target, cpu_limit_s, options = sys.argv[1:5]
    signal.setitimer(signal.ITIMER_PROF, float(cpu_limit_s))  # unhandled, SIGPROF ends the process
    with np.load(source) as content:
        mesh = coacd.Mesh(content["vertices"], content["faces"])
    parts = coacd.run_coacd(mesh, seed=0, **json.loads(options))
    arrays = {f"piece{i}": np.asarray(vertices, dtype=np.float64) for i, (vertices, _) in enumerate(parts)}
    np.savez(target, **arrays)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
