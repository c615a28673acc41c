"""Modules that import each other's packages can be the first to be imported: a command begins with any of them."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    "module",
    ["motion.robot_mask", "motion.scene", "perception.network_pushes", "report.page", "run.pipeline"],
)
def test_a_module_can_be_the_first_to_be_imported(module):
    ended = subprocess.run(
        [sys.executable, "-c", f"import s2r_host.{module}"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stderr
