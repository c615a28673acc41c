"""Targets are read in the units people use, and refused in words when they cannot be meant."""

import math
import subprocess
import sys

import pytest

from s2r_host.run.task import DRAWER, LAPTOP
from s2r_protocol.exits import UsageError


@pytest.mark.parametrize(
    ("text", "task", "value"),
    [
        ("0.15", DRAWER, 0.15),
        ("150mm", DRAWER, 0.15),
        ("-0.02m", DRAWER, -0.02),
        ("-30deg", LAPTOP, -math.pi / 6),
        ("-30°", LAPTOP, -math.pi / 6),
        ("0.5rad", LAPTOP, 0.5),
        (" 0.5 ", LAPTOP, 0.5),
    ],
)
def test_a_target_is_read_with_or_without_its_unit(text, task, value):
    assert task.targets.read(text) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "task", "words"),
    [
        ("150mm", LAPTOP, "measured in deg"),
        ("10deg", DRAWER, "measured in mm"),
        ("open", DRAWER, "not a number"),
        ("", LAPTOP, "not a number"),
        ("nan", DRAWER, "not finite"),
        ("0.7", DRAWER, "out of the cabinet"),
        ("200deg", LAPTOP, "outside"),
    ],
)
def test_a_target_that_cannot_be_meant_is_refused(text, task, words):
    with pytest.raises(UsageError, match=words):
        task.targets.read(text)


def test_the_refusal_names_the_option_that_was_given():
    for text in ("far", "nan", "5m", "10deg"):
        with pytest.raises(UsageError, match=r"^--then "):
            DRAWER.targets.read(text, "--then")


def test_a_target_is_refused_before_anything_heavy_is_loaded():
    code = (
        "import sys\nfrom s2r_protocol.cli.root import main\n"
        "try:\n    main(['run', 'drawer', '--target', 'nan'])\nexcept SystemExit as end:\n    assert end.code == 2\n"
        "heavy = {'numpy', 'mujoco', 'open3d', 'zenoh', 'pinocchio', 'cv2'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr


def test_values_are_shown_in_the_units_people_use():
    assert DRAWER.unit.show(0.00123) == "+1.23 mm"
    assert LAPTOP.unit.show(-math.pi / 6, 1) == "-30.0°"
