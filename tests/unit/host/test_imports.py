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


HEAVY = {"scipy", "cv2", "open3d", "mujoco", "matplotlib", "dash"}


def loaded_by(statement: str) -> set[str]:
    """What else Python has loaded after it, of the packages that take their time and of ours."""
    shown = f"{statement}; import sys; print(*(n for n in sys.modules if n.split('.')[0] in {HEAVY | {'s2r_host'}}))"
    told = subprocess.run(
        [sys.executable, "-c", shown], capture_output=True, text=True, check=True, timeout=120
    )
    return set(told.stdout.split())


@pytest.mark.parametrize(
    ("module", "ours"),
    [("perception.errors", {"s2r_host.perception"}), ("model.coacd_worker", {"s2r_host.model"})],
)
def test_what_needs_little_of_a_package_loads_little(module, ours):
    """An error class, and the child that cuts hulls, used to load all that estimates and builds: a second each."""
    loaded = loaded_by(f"import s2r_host.{module}")
    assert loaded == {"s2r_host", "s2r_host.late_names", f"s2r_host.{module}", *ours}


@pytest.mark.parametrize("package", ["perception", "model"])
def test_the_public_names_of_a_package_are_there_and_others_are_told_as_missing(package):
    statement = (
        f"from s2r_host.{package} import *; import s2r_host.{package} as p; assert not hasattr(p, 'joint')"
    )
    assert "scipy" in loaded_by(statement)


def test_a_run_loads_open3d_only_where_it_looks_for_a_lid():
    assert not {"open3d", "dash"} & loaded_by("import s2r_host.run.pipeline")
