"""Touches of a part: short strokes that are read together, with an effort of declared accuracy."""

import csv

import numpy as np
import pytest
import yaml

from s2r_host.gap.config import GapConfig
from s2r_host.gap.pipeline import Analysis, analyse
from s2r_host.gap.strokes import left_over, together

MODEL = """<mujoco><worldbody><body name="part">
<joint name="rail" type="slide" axis="1 0 0" frictionloss="4" damping="2"/>
<geom type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody></mujoco>"""
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
PITCH_M, SPEED_M_S = 0.03, 0.05


def touch(folder, name, start_m, way, seconds=0.6, catch_N=0.0, pull_N=0.0):
    """Recording of a part pushed at a steady speed, catches and a steady pull along its way."""
    t = np.arange(0.0, seconds, 0.005)
    q = start_m + way * SPEED_M_S * t
    noise = np.random.default_rng([round(1000 * start_m), way + 1]).normal(0.0, 0.05, len(t))
    tau = 4.0 * way + 2.0 * way * SPEED_M_S + catch_N * np.sin(2 * np.pi * q / PITCH_M) + pull_N + noise
    path = folder / f"{name}.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "q.rail", "dq.rail", "tau.rail"])
        writer.writerows(zip(t, q, np.full(len(t), way * SPEED_M_S), tau, strict=True))
    side = {"effort": "measured", "input": "effort", "session": "run", "effort_sigma": {"rail": 0.3}}
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side))
    return path


def analysed(folder, **more) -> Analysis:
    """What is said of touches all along a way of 12 cm, out and back."""
    (folder / "model.xml").write_text(MODEL)
    starts = np.linspace(0.0, 0.09, 4)
    paths = [touch(folder, f"out{k}", float(x), 1, **more) for k, x in enumerate(starts)]
    paths += [touch(folder, f"back{k}", float(x) + 0.03, -1, **more) for k, x in enumerate(starts)]
    return analyse(folder / "model.xml", paths, [], [], QUICK, lambda _: None)


def names(found: Analysis) -> list[str]:
    return [effect.name for effect in found.decision.effects] if found.decision is not None else []


def test_touches_shorter_than_a_period_show_notches_together(tmp_path):
    found = analysed(tmp_path, catch_N=3.0)
    assert found.verdict == "physics_missing"
    assert names(found)[0] == "cogging"


def test_a_steady_pull_beyond_the_declared_accuracy_is_no_zero_of_the_gauge(tmp_path):
    found = analysed(tmp_path, pull_N=2.0)
    assert found.verdict == "physics_missing"
    assert names(found)[0] in ("gravity_tilt", "asymmetric_friction", "spring_return", "cable_spring")


def test_touches_without_anything_hidden_miss_nothing(tmp_path):
    assert analysed(tmp_path).verdict in ("nothing_missing", "parameter_off")


def test_short_strokes_of_one_session_are_held_against_the_floor_as_one(tmp_path):
    problem = analysed(tmp_path).problem
    assert problem is not None
    (group,) = together(problem)
    assert len(group) == len(problem.blocks) == 8
    rows = np.full(len(problem.y), 2.0 * problem.floor[0])
    assert left_over(problem, rows, group, held=True) == pytest.approx(2.0)
    for block in problem.blocks:
        block.held[:] = False
    assert left_over(problem, rows, group, held=True) is None
