"""The C++ tests once more, built here with the address, undefined-behaviour and thread sanitizers.

Fuzzing and pairs of faults under the same sanitizers are part of `make prove` (`scripts/prove sanitize`).
"""

from __future__ import annotations

import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

NATIVE = Path(__file__).parents[2] / "executor/native"
TIMED = ("tick_takes_little_of_its_period", "hundred_thousand")  # say something about an ordinary build only
STARTS_NOT = re.compile("unexpected memory mapping|Shadow memory range interleaves|failed to intercept")
TIMEOUT_S = 1200

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3000)]


def core_sources() -> list[str]:
    """What CMake makes the core of."""
    listed = (
        (NATIVE / "CMakeLists.txt").read_text().partition("add_library(s2r_core STATIC")[2].partition(")")[0]
    )
    return listed.split()


def build(kinds: str, folder: Path) -> Path:
    """Few large units: most of the time goes into the standard library's headers."""
    core = core_sources()
    assert "packing_fd.cpp" in core
    core.remove("packing_fd.cpp")  # has constants of the same names as packing_classic.cpp
    units = (
        core,
        ["packing_fd.cpp", "tests/main.cpp", "tests/test_core.cpp", "tests/test_shm.cpp"],
        ["tests/test_time_scaling.cpp"],
        ["tests/test_units.cpp"],
    )
    flags = ["-std=c++20", "-O1", "-g1", f"-fsanitize={kinds}", "-fno-sanitize-recover=all", "-Wno-tsan"]

    def compiled(number: int) -> str:
        source = folder / f"unit{number}.cpp"
        source.write_text("".join(f'#include "{name}"\n' for name in units[number]))
        target = source.with_suffix(".o")
        command = ["g++", *flags, "-I", NATIVE, "-I", NATIVE / "tests", "-c", source, "-o", target]
        subprocess.run(command, check=True, timeout=TIMEOUT_S)
        return str(target)

    with ThreadPoolExecutor(2) as pool:
        objects = list(pool.map(compiled, range(len(units))))
    subprocess.run(["g++", *flags, *objects, "-o", folder / "tests"], check=True, timeout=TIMEOUT_S)
    return folder / "tests"


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
@pytest.mark.parametrize("kinds", ["address,undefined", "thread"])
def test_no_sanitizer_finds_anything_in_the_cpp_tests(kinds, tmp_path):
    binary = build(kinds, tmp_path)
    names = subprocess.run([binary], capture_output=True, text=True, check=False, timeout=TIMEOUT_S)
    if STARTS_NOT.search(names.stderr):
        pytest.skip(f"this kernel's address layout does not let the sanitizer start: {names.stderr[:200]}")
    assert names.returncode == 0, names.stderr
    chosen = [name for name in names.stdout.split() if not name.startswith(TIMED)]
    assert len(chosen) > 25
    for name in chosen:
        result = subprocess.run(
            [binary, name], capture_output=True, text=True, check=False, timeout=TIMEOUT_S
        )
        if STARTS_NOT.search(result.stderr):
            pytest.skip(
                f"this kernel's address layout does not let the sanitizer start: {result.stderr[:200]}"
            )
        assert result.returncode == 0, f"{name}: {result.stderr[-3000:]}"


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
def test_the_sanitizers_are_on(tmp_path):
    """A planted overrun is found: else the test above could not fail."""
    source = tmp_path / "overrun.cpp"
    source.write_text(
        "int main(int n, char**) { int* p = new int[4]; int x = p[n + 3]; delete[] p; return x & 0; }\n"
    )
    subprocess.run(
        ["g++", "-fsanitize=address", source, "-o", tmp_path / "overrun"], check=True, timeout=TIMEOUT_S
    )
    result = subprocess.run([tmp_path / "overrun"], capture_output=True, text=True, check=False)
    if STARTS_NOT.search(result.stderr):
        pytest.skip("this kernel's address layout does not let the sanitizer start")
    assert "heap-buffer-overflow" in result.stderr
