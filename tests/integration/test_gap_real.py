"""``s2r gap`` on two public recordings of real machines; skipped where the recordings are not at hand."""

import importlib
import json
import sys
from pathlib import Path

import pytest

from s2r_host.gap.cli import run_gap
from s2r_protocol.exits import ExitCode

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))
shared_data = importlib.import_module("gap_real.case").shared_data


def answer_of(machine, name, folder, tmp_path):
    """gap.json of one case of the bench, without its forward simulations."""
    if not (shared_data() / folder).is_dir():
        pytest.skip(f"no recordings: {shared_data() / folder} is absent (S2R_SHARED_DATA)")
    cases = importlib.import_module(f"gap_real.{machine}").cases(tmp_path)
    case = next(c for c in cases if c.name == name)
    config = tmp_path / "gap.yaml"
    config.write_text("simulate: false\n")
    code = run_gap(case.model, case.fit, case.holdout, case.repeat, config, tmp_path / "out")
    assert code == ExitCode.DIFFERENCE
    return json.loads((tmp_path / "out" / "gap.json").read_text())


def test_the_friction_device_has_play(tmp_path):
    answer = answer_of("brfd", "brfd_d2", "brfd_friction_backlash", tmp_path)
    assert [e["name"] for e in answer["effects"]] == ["backlash"]
    width = answer["effects"][0]["parameters"]["half_width"]
    assert width["unit"] == "m"
    assert 1.5e-3 < width["value"] < 3e-3


def test_the_cogging_order_of_a_motor_is_found_unaided(tmp_path):
    answer = answer_of("laas", "laas", "laas_cogging", tmp_path)
    assert answer["effects"][0]["name"] == "cogging"
    assert answer["effects"][0]["parameters"]["order"]["value"] == pytest.approx(72, abs=0.1)
