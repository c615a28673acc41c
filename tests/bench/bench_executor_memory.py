"""Resident memory of the executor's processes: idle, in motion, and while a fault latches and the black box is written.

    python tests/bench/bench_executor_memory.py [--seconds 40] [--pace 4]

Real processes on a stand-in in lock-step; plans of 500 points to and fro until the black box is full, then one joint's
answers are lost for good: the core latches. VmHWM is the largest there ever was, start-up included.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_host.link import ExecutorLink
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import S2RError
from s2r_protocol.faults import ExecutorState

ARM = load_arm("xmate3pro")
STEP = np.array([0.5, 0.3, -0.3, -0.3, 0.4, 0.3, 0.5])
START_S = 120.0


def free_endpoint() -> str:
    """A TCP address of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@dataclass(frozen=True)
class Move:
    """Knots of a plan: times [s], positions and derivatives, shape (n, dof)."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


def move(q: np.ndarray, step: np.ndarray, duration_s: float = 4.0, knots: int = 500) -> Move:
    """Minimum jerk from ``q`` [rad], shape (dof,)."""
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    s, ds = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration_s
    dds = 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
    return Move(t, q + s[:, None] * step, ds[:, None] * step, dds[:, None] * step)


@contextmanager
def process(arguments: list[str], ready: Path) -> Iterator[subprocess.Popen[bytes]]:
    """``s2r ARGUMENTS`` from the moment it is ready."""
    log = ready.with_suffix(".log")
    with log.open("wb") as stream:
        command = [sys.executable, "-m", "s2r_protocol", *arguments, "--ready-file", str(ready)]
        started = subprocess.Popen(command, stdout=stream, stderr=stream)
    try:
        until = time.monotonic() + START_S
        while not ready.exists():
            if started.poll() is not None or time.monotonic() > until:
                sys.exit(f"s2r {arguments[0]} did not start:\n{log.read_text()}")
            time.sleep(0.05)
        yield started
    finally:
        started.terminate()
        started.wait()


def memory_mb(pid: int) -> dict[str, dict[str, float]]:
    """Resident now and at most [MB, 10^6 bytes] of a process and its children, by role."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    found = {}
    for one in (str(pid), *children):
        name = Path(f"/proc/{one}/comm").read_text().strip()
        role = "front end" if one == str(pid) else name if name == "s2r-rt" else "recorder"
        fields = dict(line.split(":", 1) for line in Path(f"/proc/{one}/status").read_text().splitlines())
        found[role] = {key: int(fields[key].split()[0]) * 1024e-6 for key in ("VmRSS", "VmHWM")}
    return found


def show(when: str, found: dict[str, dict[str, float]]) -> None:
    """One row of the table."""
    cells = (f"{role} {m['VmRSS']:.0f} (at most {m['VmHWM']:.0f})" for role, m in found.items())
    print(f"| {when} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seconds", type=float, default=40.0, help="simulated, until the fault (black box: 30)"
    )
    parser.add_argument("--pace", type=float, default=4.0, help="simulated over real seconds, at most")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="s2r-memory-") as name:
        folder = Path(name)
        common = ["--bus", f"unix:{folder}/bus", "--clock", "lockstep", "--pace", str(options.pace)]
        first = round(options.seconds * 1000)
        lost = ["--inject", f"drop:0x183@{first}-{first + 10**6}"]
        endpoint = free_endpoint()
        record = ["--record", str(folder / "recordings"), "--host-timeout", "5"]
        with (
            process(["sim-arm", "--seed", "1", *common, *lost, "--listen", free_endpoint()], folder / "sim"),
            process(["executor", *common, *record, "--listen", endpoint], folder / "executor") as executor,
        ):
            show("ready", memory_mb(executor.pid))
            with ExecutorLink(endpoint, ARM) as host, host.leased():
                status = host.arm_drives()
                forth = 1.0
                try:
                    while True:
                        done = host.wait_done(host.send_plan(move(status.q_ref, forth * STEP), "memory"))
                        status, forth = done, -forth
                except S2RError as error:
                    if host.status().state != ExecutorState.FAULT:
                        raise
                    print(f"latched as wanted: {error}", file=sys.stderr)
                show("as the fault latched", memory_mb(executor.pid))
                until = time.monotonic() + START_S
                while not list((folder / "recordings").rglob("blackbox-*.npz")) and time.monotonic() < until:
                    time.sleep(0.05)
                for _ in range(20):
                    time.sleep(0.1)
                show("two seconds later", memory_mb(executor.pid))
            boxes = list((folder / "recordings").rglob("blackbox-*.npz"))
            print(f"black box: {', '.join(f'{os.path.getsize(box) * 1e-6:.1f} MB' for box in boxes)}")


if __name__ == "__main__":
    main()
