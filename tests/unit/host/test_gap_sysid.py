"""The baseline of mujoco.sysid: it finds a wrong number, stops at its limit, and says what it lacks."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco import sysid

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.output import sysid as baseline
from s2r_host.gap.output.extras import near_network
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.rig import Drive, Secret, write_case, write_model
from s2r_host.gap.simulation.forward import evaluate
from s2r_host.gap.simulation.replay import build_twin


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    """A pendulum a tenth heavier than its model, and nothing else."""
    case = write_case(tmp_path_factory.mktemp("heavy"), Secret(mass_factor=1.1), Drive(duration_s=5.0))
    config = GapConfig(simulate=False, baselines=False)
    return analyse(case["model"], [case["fit"]], [case["holdout"]], [], config, lambda _: None)


def error(a, moved=None):
    twin = build_twin(a.model, a.problem.ctx, [], moved)
    return float(evaluate(twin, a.fit, a.hold, [0]).open_held[0])


def test_a_wrong_mass_is_taken_up_within_bounds_and_held_out_motion_is_met(heavy):
    found = baseline.identify(heavy.problem, heavy.fit, True)
    assert isinstance(found, baseline.Identified), found
    assert not found.cut_off
    assert error(heavy, found.moved) < 0.3 * error(heavy)
    told = found.as_json()
    assert told["how"].startswith(f"mujoco.sysid: {len(found.moved)} numbers of the model")
    numbers = {p["name"]: p for p in told["parameters"]}
    assert numbers["mass"]["body"] == "arm"
    assert numbers["mass"]["from"] == pytest.approx(1.2)
    weight = numbers["mass"]["to"] * numbers["com_z"]["to"]
    assert weight == pytest.approx(-1.1 * 1.2 * 0.25, rel=0.03)
    assert numbers["damping"]["to"] > 0.0


def test_what_is_cut_off_is_the_best_so_far_and_says_so(heavy):
    found = baseline.identify(heavy.problem, heavy.fit, True, limit_s=-1.0)
    assert isinstance(found, baseline.Identified), found
    assert found.cut_off
    assert not np.any([x for _, x in found.moved])
    assert "cut off after 40 s of processor time" in found.as_json()["how"]


def test_its_motors_pass_the_recorded_effort_on_whatever_the_defaults_say_of_motors(tmp_path):
    own = '<general gear="50" ctrllimited="true" ctrlrange="-1 1" gainprm="3" forcelimited="true" forcerange="-2 2"/>'
    path = write_model(tmp_path / "model.xml")
    text = path.read_text(encoding="utf-8").replace("<worldbody>", f"<default>{own}</default><worldbody>")
    motor = '<actuator><general joint="elbow"/></actuator>'
    path.write_text(text.replace("</mujoco>", f"{motor}</mujoco>"), encoding="utf-8")
    model = RigidModel(path)
    session: Any = SimpleNamespace(lead=np.zeros(1))
    driven = baseline._driven(model, session).compile()
    data = mujoco.MjData(driven)
    data.ctrl[0] = 7.0
    mujoco.mj_forward(driven, data)
    assert driven.nu == 1
    assert data.qfrc_actuator[0] == pytest.approx(7.0)


def test_a_toolbox_without_its_packages_is_told(heavy, monkeypatch):
    monkeypatch.delattr(sysid, "optimize")
    assert "pip install 'mujoco[sysid]'" in str(baseline.identify(heavy.problem, heavy.fit, True))


def test_a_name_is_near_the_network_up_to_a_tenth_more_or_within_the_noise():
    assert near_network(1.09, 1.0, 0.0)
    assert not near_network(1.11, 1.0, 0.0)
    assert near_network(1.11, 0.1, 1.05)
