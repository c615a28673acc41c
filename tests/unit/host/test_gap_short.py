"""Recordings of a second, as an arm makes them while it pushes something, and what they may be used for."""

import csv

import numpy as np
import pytest
import yaml

from s2r_host.gap.config import GapConfig
from s2r_host.gap.pipeline import analyse

MODEL = """<mujoco><worldbody><body name="part">
<joint name="rail" type="slide" axis="1 0 0" frictionloss="4" damping="2"/>
<geom type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody></mujoco>"""
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)


def pushed(folder, seconds: float, wobble_N: float, side: dict | None = None):
    """A drawer pushed once; the force gauge is off by slow errors of a given size."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, seconds, 0.005)
    x = t / seconds
    q, dq = 0.1 * (10 * x**3 - 15 * x**4 + 6 * x**5), 0.1 / seconds * 30 * x**2 * (1 - x) ** 2
    slow = sum(np.sin(2 * np.pi * f * t + p) for f, p in ((0.7, 1.0), (1.9, 2.0), (3.1, 0.3)))
    tau = (
        4.0 * np.tanh(dq / 1e-3)
        + 2.0 * dq
        + 2.0 * np.gradient(dq, t)
        + wobble_N * slow
        + rng.normal(0, 0.05, len(t))
    )
    path = folder / "push.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "q.rail", "dq.rail", "tau.rail"])
        writer.writerows(zip(t, q, dq, tau, strict=True))
    path.with_suffix(".yaml").write_text(
        yaml.safe_dump({"effort": "measured", "input": "effort", **(side or {})})
    )
    (folder / "model.xml").write_text(MODEL)
    return analyse(folder / "model.xml", [path], [], [], QUICK, lambda _: None)


def test_a_third_of_a_second_is_too_short_and_said_so(tmp_path):
    found = pushed(tmp_path, 0.35, 0.0)
    assert found.verdict == "insufficient"
    assert any("too short" in note for note in found.notes)


@pytest.mark.parametrize(
    ("declared", "verdicts"), [(False, {"unknown", "physics_missing"}), (True, {"insufficient"})]
)
def test_errors_of_the_gauge_look_like_physics_unless_its_accuracy_is_declared(tmp_path, declared, verdicts):
    side = {"effort_sigma": {"rail": 0.6}} if declared else {}
    assert pushed(tmp_path, 2.5, 0.4, side).verdict in verdicts
