"""Runs ``s2r_campaign`` and hands what was on its bus to the oracle, episode by episode."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from s2r_sim.bus import oracle

ROOT = Path(__file__).parents[2]
DOF = 7
ROW = np.dtype(
    [
        ("kind", "u1"),
        ("control", "u1"),
        ("flags", "<u2"),
        ("episode", "<u4"),
        ("tick", "<u8"),
        ("counts", "<i4", DOF),
        ("extra", "<u4"),
    ]
)
COMMAND, ARM, MOTION, END = range(4)
LIMITS = oracle.Limits(*(np.full(DOF, x) for x in (-2.9, 2.9, 3.0, 6.0, 300.0)))
CHUNK_ROWS = 200_000
SANITIZED = ("prove-address", "prove-thread")


def executable() -> Path:
    """The newest ordinary build; skips without one. Under a sanitizer a campaign takes ten times as long."""
    found = sorted(
        (p for p in ROOT.glob("build/*/executor/native/tests/s2r_campaign") if p.parts[-5] not in SANITIZED),
        key=lambda p: p.stat().st_mtime,
    )
    if not found:
        pytest.skip("no s2r_campaign under build/: configure with -DS2R_BUILD_TESTS=ON")
    return found[-1]


def _rows(*arguments: object) -> Iterator[np.ndarray]:
    command = [executable(), *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        while data := process.stdout.read(CHUNK_ROWS * ROW.itemsize):
            yield np.frombuffer(data, ROW)
        said = process.stderr.read().decode()
    print(said, end="")
    assert process.returncode == 0, said


def run(what: str, first: int, count: int, gaps_allowed: bool) -> dict[str, float]:
    """Judge everything; returns how many commands and episodes there were and the largest use of each limit."""
    totals = {"commands": 0.0, "episodes": 0.0, "velocity": 0.0, "acceleration": 0.0, "jerk": 0.0}
    left = np.empty(0, ROW)
    for chunk in _rows(what, first, count):
        rows = np.concatenate([left, chunk])
        ends = np.flatnonzero(rows["kind"] == END)
        begin = 0
        for end in ends:
            _judge(rows[begin:end], gaps_allowed, totals)
            totals["episodes"] += 1
            begin = end + 1
        left = rows[begin:]
    assert not len(left), "the last episode has no end"
    return totals


def _judge(rows: np.ndarray, gaps_allowed: bool, totals: dict[str, float]) -> None:
    commands = rows[rows["kind"] == COMMAND]
    bits = (commands["flags"][:, None] >> np.arange(DOF)) & 1
    trace = oracle.Trace(
        tick=commands["tick"].astype(np.int64),
        control=commands["control"].astype(np.int64),
        counts=commands["counts"].astype(np.int64),
        enabled=bits.astype(bool),
        faulty=np.zeros((len(commands), DOF), bool),
        dt=1e-3,
    )
    report = oracle.judge(
        trace,
        LIMITS,
        None,
        rows["tick"][rows["kind"] == ARM].tolist(),
        rows["tick"][rows["kind"] == MOTION].tolist(),
        gaps_allowed=gaps_allowed,
    )
    assert not report.violations, f"episode {rows['episode'][0]}: {report}"
    totals["commands"] += len(commands)
    for name, share in report.use.items():
        totals[name] = max(totals[name], share)
