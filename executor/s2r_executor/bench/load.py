"""What else the machine does while the loop is measured: Zenoh traffic, MuJoCo on the other CPU."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_PUBLISH = """
import json, sys, time, zenoh
config = zenoh.Config()
for key, value in (("mode", "peer"), ("connect/endpoints", [sys.argv[1]]), ("listen/endpoints", []),
                   ("connect/timeout_ms", 0), ("connect/exit_on_failure", False),
                   ("scouting/multicast/enabled", False), ("scouting/gossip/enabled", False)):
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
put = session.declare_publisher("bench/load").put
payload, due = bytes(100), time.monotonic()
while True:
    put(payload)
    due += 0.001
    time.sleep(max(due - time.monotonic(), 0.0))
"""

_SIMULATE = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody>" + "".join(
        f"<body pos='{i} 0 1'><freejoint/><geom type='box' size='.1 .2 .3'/></body>" for i in range(8)
    ) + "<geom type='plane' size='20 20 .1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
while True:
    mujoco.mj_step(model, data)
"""


def free_endpoint() -> str:
    """A loopback endpoint that nobody listens on right now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def publisher(endpoint: str, cpus: set[int]) -> Iterator[None]:
    """1000 messages of 100 bytes per second to ``endpoint``, from a process of its own."""
    with _python(_PUBLISH, cpus, endpoint):
        yield


@contextmanager
def simulation(cpus: set[int]) -> Iterator[None]:
    """One MuJoCo loop without a pause per CPU."""
    if not cpus:
        yield
        return
    first, *rest = sorted(cpus)
    with _python(_SIMULATE, {first}), simulation(set(rest)):
        yield


@contextmanager
def _python(code: str, cpus: set[int], *arguments: str) -> Iterator[None]:
    process = subprocess.Popen(
        ["nice", "-n", "10", sys.executable, "-c", code, *arguments], stderr=subprocess.PIPE, text=True
    )
    os.sched_setaffinity(process.pid, cpus)
    try:
        yield
        if process.poll() is not None:
            said = process.stderr.read() if process.stderr is not None else ""
            raise RuntimeError(f"a load of the benchmark ended by itself: {said[-500:]}")
    finally:
        process.kill()
        process.communicate()
