"""How much CPU `s2r stop` takes before it asks: nobody listens, so it starts, connects, and gives up.

    python tests/bench/bench_stop_start.py

Budget: 150 ms of CPU, at the median of starts that find compiled bytecode, as every start but the first does.
An empty Python process beside it shows how fast the machine is just now.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile

import numpy as np

BUDGET_S = 0.150
STOP = ("-m", "s2r_protocol", "stop", "--executor", "tcp/127.0.0.1:1", "--timeout", "0")
EMPTY = ("-c", "pass")


def cpu_s(arguments: tuple[str, ...], code: int, bytecode: str) -> float:
    """CPU time of one start that must end with ``code``, user and system [s]; ``bytecode`` is a folder for it."""
    inherited = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    process = subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=inherited | {"PYTHONPYCACHEPREFIX": bytecode},
    )
    _, status, usage = os.wait4(process.pid, 0)
    ended = os.waitstatus_to_exitcode(status)
    assert ended == code, f"it ended with {ended}, expected {code}"
    return usage.ru_utime + usage.ru_stime


def figures(found: np.ndarray) -> str:
    p50, p99 = 1e3 * np.quantile(found, [0.5, 0.99])
    return f"p50 {p50:.0f} ms, p99 {p99:.0f} ms, worst {1e3 * found.max():.0f} ms"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    runs = range(parser.parse_args().runs)
    with tempfile.TemporaryDirectory() as cache:
        cpu_s(STOP, 5, cache)  # writes the bytecode
        empty = np.array([cpu_s(EMPTY, 0, cache) for _ in runs])
        usual = np.array([cpu_s(STOP, 5, cache) for _ in runs])
    print(f"s2r stop, CPU to the first question: {figures(usual)}")
    print(f"an empty Python process: {figures(empty)}")
    kept = float(np.median(usual)) <= BUDGET_S
    print(f"budget {1e3 * BUDGET_S:.0f} ms: {'kept' if kept else 'not kept'} (p50)")


if __name__ == "__main__":
    main()
