"""Runs the C++ tests that CMake has built (option S2R_BUILD_TESTS); builds nothing itself."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SANITIZED = ("prove-address", "prove-thread")  # timed there, they say nothing
BINARIES = sorted(
    (
        path
        for path in ROOT.glob("build/*/executor/native/tests/s2r_cpp_tests")
        if path.parts[-5] not in SANITIZED
    ),
    key=lambda path: path.stat().st_mtime,
)


def names() -> list[str]:
    if not BINARIES:
        return []
    return subprocess.run([BINARIES[-1]], capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.skipif(not BINARIES, reason="no s2r_cpp_tests under build/: configure with -DS2R_BUILD_TESTS=ON")
@pytest.mark.parametrize("name", names() or ["none built"])
def test_cpp(name):
    result = subprocess.run([BINARIES[-1], name], capture_output=True, text=True, timeout=600)
    print(result.stdout)
    assert result.returncode == 0, result.stderr
