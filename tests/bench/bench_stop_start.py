"""How much CPU `s2r stop` takes before it asks: nobody listens, so it starts, connects, and gives up.

    python tests/bench/bench_stop_start.py

Budget: 150 ms of CPU.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys

import numpy as np

BUDGET_S = 0.150


def cpu_s() -> float:
    """CPU time of one start, user and system [s]."""
    command = [
        sys.executable,
        "-m",
        "s2r_protocol",
        "stop",
        "--executor",
        "tcp/127.0.0.1:1",
        "--timeout",
        "0",
    ]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 5, "it must end with 'peer unreachable'"
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    runs = parser.parse_args().runs
    cpu_s()  # once for the page cache
    found = np.array([cpu_s() for _ in range(runs)])
    p50, p99 = 1e3 * np.quantile(found, [0.5, 0.99])
    print(
        f"s2r stop, CPU to the first question: p50 {p50:.0f} ms, p99 {p99:.0f} ms, worst {1e3 * found.max():.0f} ms"
    )
    print(f"budget {1e3 * BUDGET_S:.0f} ms: {'kept' if p50 <= 1e3 * BUDGET_S else 'not kept'} (p50)")


if __name__ == "__main__":
    main()
