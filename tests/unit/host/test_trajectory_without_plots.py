"""The planner is loaded without the plotting library that toppra imports."""

from __future__ import annotations

import subprocess
import sys

_LOADED = """
import sys
import s2r_host.trajectory.plan_scene
import toppra
assert toppra is s2r_host.trajectory.without_plots.toppra
assert not [name for name in sys.modules if name.startswith("matplotlib")]
import toppra.algorithm.algorithm as inside
if sys.argv[1] == "of toppra":
    real = inside.plt.plot
    import matplotlib.pyplot as plt
else:
    import matplotlib.pyplot as plt
    real = inside.plt.plot
assert real is plt.plot
"""


def _assert_runs(order: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", _LOADED, order], capture_output=True, text=True, check=False, timeout=120.0
    )
    assert ended.returncode == 0, ended.stderr


def test_planner_is_loaded_without_matplotlib_and_toppra_gets_it_when_it_asks() -> None:
    _assert_runs("of toppra")


def test_matplotlib_imported_afterwards_is_the_real_one_and_toppra_has_the_same() -> None:
    _assert_runs("of others")
