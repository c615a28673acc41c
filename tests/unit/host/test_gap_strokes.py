"""Touches of a part: short strokes that are read together, with an effort of declared accuracy."""

import csv

import numpy as np
import pytest
import yaml

from s2r_host.gap.config import GapConfig
from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion.checks import check_efforts
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.pipeline import Analysis, analyse
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.nuisance import COMPARISON
from s2r_host.gap.regression.strokes import left_over, together
from s2r_host.gap.search.search import Search

MODEL = """<mujoco><worldbody><body name="part">
<joint name="rail" type="slide" axis="1 0 0" frictionloss="4" damping="2"/>
<geom type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody></mujoco>"""
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
PITCH_M, SPEED_M_S = 0.03, 0.05


def touch(folder, name, start_m, way, seconds=0.6, catch_N=0.0, pull_N=0.0, scale=1.0, off_m=0.0, side=None):
    """Recording of a part pushed at a steady speed, catches and a steady pull along its way.

    Efforts are told ``scale`` times too large, positions ``off_m`` too far; ``side`` is put into the side file.
    """
    t = np.arange(0.0, seconds, 0.005)
    q = start_m + way * SPEED_M_S * t
    noise = np.random.default_rng([round(1000 * start_m), way + 1]).normal(0.0, 0.05, len(t))
    tau = 4.0 * way + 2.0 * way * SPEED_M_S + catch_N * np.sin(2 * np.pi * q / PITCH_M) + pull_N + noise
    tau *= scale
    path = folder / f"{name}.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "q.rail", "dq.rail", "tau.rail"])
        writer.writerows(zip(t, q + off_m, np.full(len(t), way * SPEED_M_S), tau, strict=True))
    usual = {"effort": "measured", "input": "effort", "session": "run", "effort_sigma": {"rail": 0.3}}
    path.with_suffix(".yaml").write_text(yaml.safe_dump(usual | (side or {})))
    return path


def stroke(folder, name, t, v, tau, sigma_N):
    """Recording of one stroke, rows every 8 ms, its effort told to be good to ``sigma_N``."""
    path = folder / f"{name}.csv"
    rows = np.stack([t, np.cumsum(v) * 0.008, v, tau], axis=1)
    np.savetxt(path, rows, delimiter=",", header="t,q.rail,dq.rail,tau.rail", comments="")
    side = {"effort": "measured", "input": "effort", "session": "run", "effort_sigma": {"rail": sigma_N}}
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side))
    return path


def braked(folder, sticks_N, damping, believed=15.0) -> Analysis:
    """What is said of strokes at falling, usual and slow speed on a rail that sticks where it is slow."""
    slides = MODEL.replace('frictionloss="4" damping="2"', f'frictionloss="3" damping="{believed}"')
    (folder / "model.xml").write_text(slides)
    paths = []
    for k, (first, last, seconds, way) in enumerate(
        [(0.1, 0.015, 0.6, -1), (0.057, 0.057, 1.8, -1), (0.03, 0.06, 2.0, 1), (0.016, 0.016, 5.0, -1)]
    ):
        t = np.arange(0.0, seconds, 0.008)
        v = way * np.linspace(first, last, len(t))
        friction = 2.6 + sticks_N * np.exp(-((v / 0.02) ** 2))
        noise = np.random.default_rng(k).normal(0.0, 0.05, len(t))
        tau = way * friction + damping * v + 2.0 * np.gradient(v, t) + noise
        paths.append(stroke(folder, f"stroke{k}", t, v, tau, 0.28))
    return analyse(folder / "model.xml", paths, [], [], QUICK, lambda _: None)


def analysed(folder, scales=(1.0,) * 8, offs=(0.0,) * 8, **more) -> Analysis:
    """What is said of touches all along a way of 12 cm, out and back."""
    (folder / "model.xml").write_text(MODEL)
    starts = np.linspace(0.0, 0.09, 4)
    ways = [(f"out{k}", float(x), 1) for k, x in enumerate(starts)]
    ways += [(f"back{k}", float(x) + 0.03, -1) for k, x in enumerate(starts)]
    paths = [
        touch(folder, *way, scale=scale, off_m=off, **more)
        for way, scale, off in zip(ways, scales, offs, strict=True)
    ]
    return analyse(folder / "model.xml", paths, [], [], QUICK, lambda _: None)


def names(found: Analysis) -> list[str]:
    return [effect.name for effect in found.decision.effects] if found.decision is not None else []


def test_touches_shorter_than_a_period_show_notches_together(tmp_path):
    found = analysed(tmp_path, catch_N=3.0)
    assert found.verdict == "physics_missing"
    assert names(found)[0] == "cogging"


def test_notches_are_seen_through_positions_that_are_off_where_that_is_declared(tmp_path):
    offs = (0.005, -0.004, 0.001, -0.005, 0.004, -0.003, 0.005, -0.002)
    said, amplitude_N = {}, {}
    for key, side in (("told", {"position_sigma": {"rail": 0.003}}), ("untold", {})):
        folder = tmp_path / key
        folder.mkdir()
        said[key] = analysed(folder, offs=offs, catch_N=3.0, side=side)
        decision = said[key].decision
        assert decision is not None
        amplitude_N[key] = decision.effects[0].parameters["amplitude"]["value"]
    assert names(said["told"]) == ["cogging"]
    assert amplitude_N["told"] == pytest.approx(3.0, rel=0.1)
    assert any("agree with one another once shifted" in note for note in said["told"].notes)
    assert amplitude_N["untold"] < 0.95 * amplitude_N["told"] or names(said["untold"]) != ["cogging"]


def test_a_steady_pull_beyond_the_declared_accuracy_is_no_zero_of_the_gauge(tmp_path):
    found = analysed(tmp_path, pull_N=2.0)
    assert found.verdict == "physics_missing"
    assert names(found)[0] in ("gravity_tilt", "asymmetric_friction", "spring_return", "cable_spring")


def test_a_rail_that_sticks_is_no_damping_below_zero(tmp_path):
    found = braked(tmp_path, sticks_N=1.3, damping=15.0)
    assert names(found)[:1] == ["stribeck"]


@pytest.mark.parametrize(("dry", "believed"), [(3.3, 15.0), (3.5, 12.0)])
def test_friction_that_falls_with_the_speed_below_nothing_gets_no_name_of_friction(tmp_path, dry, believed):
    """A rail that sticks, felt slowly one way only: less friction that way the faster it goes, says a slope."""
    slides = MODEL.replace('frictionloss="4" damping="2"', f'frictionloss="{dry}" damping="{believed}"')
    (tmp_path / "model.xml").write_text(slides)
    paths = []
    for k, (first, last, seconds, way) in enumerate(
        [(0.1, 0.015, 0.6, 1), (0.06, 0.03, 1.0, 1), (0.055, 0.03, 1.0, -1), (0.006, 0.006, 4.0, -1)]
    ):
        t = np.arange(0.0, seconds, 0.008)
        v = way * np.linspace(first, last, len(t))
        friction = 2.6 + 1.3 * np.exp(-((v / 0.02) ** 2))
        noise = np.random.default_rng(k).normal(0.0, 0.05, len(t))
        tau = way * friction + 2.0 * v + 2.0 * np.gradient(v, t) + noise
        paths.append(stroke(tmp_path, f"stroke{k}", t, v, tau, 0.3))
    found = analyse(tmp_path / "model.xml", paths, [], [], QUICK, lambda _: None)
    assert names(found) in ([], ["stribeck"])


def test_damping_that_is_not_there_is_a_number_that_is_off(tmp_path):
    found = braked(tmp_path, sticks_N=0.0, damping=1.0)
    assert found.verdict == "parameter_off"
    assert found.decision is not None
    assert [entry["name"] for entry in found.decision.parameters_off] == ["damping"]


@pytest.mark.parametrize(("times", "refused"), [(1.0, False), (1000.0, True)])
def test_a_catch_along_a_short_stroke_is_no_other_unit(tmp_path, times, refused):
    """It falls while the part slows down: as the little that the model needs does, but far steeper."""
    (tmp_path / "model.xml").write_text(MODEL)
    model = RigidModel(tmp_path / "model.xml")
    t = np.arange(0.0, 0.8, 0.005)
    v = np.linspace(0.03, 0.01, len(t))
    q = np.cumsum(v) * 0.005
    tau = times * (4.0 + 2.0 * v - 150.0 * q)
    channels = {"q": {"rail": q}, "dq": {"rail": v}, "tau": {"rail": tau}}
    s = make_session(
        model, Recording("stroke", t, channels, Controller("none"), "measured", "effort", "a", "", ()), 0
    )
    if refused:
        with pytest.raises(GapRecordingError, match="another unit"):
            check_efforts(model, s)
    else:
        check_efforts(model, s)


def test_touches_without_anything_hidden_miss_nothing(tmp_path):
    assert analysed(tmp_path).verdict in ("nothing_missing", "parameter_off")


def test_a_lever_of_doubtful_length_is_no_physics_where_that_is_declared(tmp_path):
    scales = (1.15, 0.9, 1.1, 0.85, 0.95, 1.12, 0.88, 1.05)
    verdicts = []
    for gain in ({}, {"effort_gain_sigma": {"rail": 0.12}}):
        folder = tmp_path / str(len(gain))
        folder.mkdir()
        found = analysed(folder, scales=scales, side={"effort_sigma": {"rail": 0.1}} | gain)
        verdicts.append(found.verdict)
    assert verdicts[0] in ("unknown", "physics_missing")
    assert verdicts[1] in ("nothing_missing", "parameter_off")
    assert found.problem is not None
    assert sum(p.name == "gain" for p in found.problem.base) == len(scales)
    held = found.problem.prior_at(0.05) / found.problem.prior
    expected = [1.0 if p.name in COMPARISON else 0.05 for p in found.problem.base]
    assert held == pytest.approx(expected)  # trust in the machine's numbers says nothing about the comparison


@pytest.mark.parametrize(("sigma", "enough"), [(0.2, True), (0.02, False)])
def test_scales_explain_efforts_only_as_far_as_declared(tmp_path, sigma, enough):
    """One touch in eight takes more: a slow one of a lever that sticks, say, or a lever that was told too short."""
    side = {"effort_sigma": {"rail": 0.1}, "effort_gain_sigma": {"rail": sigma}}
    problem = analysed(tmp_path, scales=(1.0, 1.0, 1.3, 1.0, 1.0, 1.0, 1.0, 1.0), side=side).problem
    assert problem is not None
    assert Search(problem).at_floor([]) == enough


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
