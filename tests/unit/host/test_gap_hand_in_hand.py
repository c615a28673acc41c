"""A door pulled open once: its catch and its friction each predict badly alone, and well together."""

import csv

import numpy as np
import pytest
import yaml

from s2r_host.gap.config import GapConfig
from s2r_host.gap.pipeline import analyse

MODEL = """<mujoco><option gravity="0 0 0"/><worldbody><body name="door">
<joint name="hinge" type="hinge" axis="0 0 1" damping="0.1"/>
<inertial mass="3" pos="0.15 0 0" diaginertia="0.03 0.03 0.03"/></body></worldbody></mujoco>"""
FRICTION_Nm, PEAK_Nm, PLACE_rad, WIDTH_rad = 1.0, 6.0, -0.2, 0.4
STEADY = ("coulomb_friction", "spring_return")  # one way, friction is a constant pull


@pytest.fixture
def pulled(tmp_path):
    """Opens the door slowly over 1.6 rad in 9 s and analyses what the handle felt; ``catch`` is its peak [N·m]."""

    def analysed(catch: float):
        rng = np.random.default_rng(4)
        t = np.arange(0.0, 9.0, 0.01)
        q = 1.6 * (
            t / 9.0 + 0.012 * np.sin(5.6 * t) + 0.006 * np.sin(11.3 * t)
        )  # by fits and starts, one way
        dq = np.gradient(q, t)
        x = (q - PLACE_rad) / WIDTH_rad
        slow = sum(np.sin(2 * np.pi * f * t + p) for f, p in ((0.6, 1.0), (1.3, 2.0), (2.1, 0.3)))
        tau = FRICTION_Nm + 0.1 * dq + catch * x * np.exp(0.5 - 0.5 * x**2) + 0.15 * slow
        tau += rng.normal(0.0, 0.05, len(t))
        path = tmp_path / "pull.csv"
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["t", "q.hinge", "tau.hinge"])
            writer.writerows(zip(t, q, tau, strict=True))
        path.with_suffix(".yaml").write_text(
            yaml.safe_dump({"effort": "measured", "input": "effort", "session": "pull"})
        )
        (tmp_path / "model.xml").write_text(MODEL)
        quick = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
        found = analyse(tmp_path / "model.xml", [path], [], [], quick, lambda _: None)
        assert found.decision is not None
        return found.decision

    return analysed


def test_a_catch_beside_friction_is_found_in_a_single_pull(pulled):
    decision = pulled(PEAK_Nm)
    assert decision.verdict == "physics_missing"
    named = {e.name: e for e in decision.effects}
    assert len(named) == 2
    assert any(name in named for name in STEADY)
    catch = named["detent"].parameters
    assert catch["position"]["value"] + catch["width"]["value"] == pytest.approx(
        PLACE_rad + WIDTH_rad, abs=0.04
    )
    assert catch["peak"]["value"] == pytest.approx(PEAK_Nm, rel=0.2)


def test_friction_alone_is_no_catch(pulled):
    assert [e.name for e in pulled(0.0).effects if e.name not in STEADY] == []
