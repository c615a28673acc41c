"""What else the machine does while the loop is measured: Zenoh traffic, MuJoCo on the other CPU, hogs."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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


_COMPUTE = """
while True:
    sum(range(100_000))
"""

_ALLOCATE = """
while True:
    memory = bytearray(256 << 20)
    memory[::4096] = b"x" * len(memory[::4096])
"""

_WRITE = """
import os, sys
data = bytes(1 << 20)
while True:
    with open(sys.argv[1], "wb") as file:
        for _ in range(64):
            file.write(data)
        file.flush()
        os.fsync(file.fileno())
"""

_CAMERA = """
import socket, threading, time
listener = socket.create_server(("127.0.0.1", 0))
sender = socket.create_connection(listener.getsockname())
receiver, _ = listener.accept()
def take():
    while receiver.recv(1 << 16):
        pass
threading.Thread(target=take, daemon=True).start()
frame, due = bytes(1280 * 720), time.monotonic()  # 22 of them per second are 20 MB/s
while True:
    sender.sendall(frame)
    due += len(frame) / 20e6
    time.sleep(max(due - time.monotonic(), 0.0))
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
def hogs(cpus: set[int], folder: Path) -> Iterator[None]:
    """CPU time, memory, disk writes and 20 MB/s through the loopback interface, a process for each."""
    file = folder / "hog.bin"
    try:
        with (
            _python(_COMPUTE, cpus),
            _python(_ALLOCATE, cpus),
            _python(_WRITE, cpus, str(file)),
            _python(_CAMERA, cpus),
        ):
            yield
    finally:
        file.unlink(missing_ok=True)


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
