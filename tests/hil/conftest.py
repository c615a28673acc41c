"""Fixtures of the HIL tests. The helpers beside this file are plain modules, since test folders are no packages."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("s2r_executor._native", reason="the native core is not built")
pytest.importorskip("mujoco", reason="the stand-in needs mujoco")

from hil_bench import Bench


@pytest.fixture
def make_bench(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    """Benches that end with the test."""
    made: list[Bench] = []

    def make(**options: object) -> Bench:
        made.append(Bench(tmp_path, **options))
        return made[-1]

    yield make
    for bench in made:
        bench.close()


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """Seven drives on the CAN FD packing, a core that has just started."""
    return make_bench()
