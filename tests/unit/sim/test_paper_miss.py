"""To which stage a miss is owed: the terms of δ from a trial's files, and the rules on rows made for each of them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from s2r_sim.paper.miss import stage_of_miss, terms_of_error
from s2r_sim.paper.page import write_page
from s2r_sim.paper.summary import causes, merit
from s2r_sim.paper.trials import draw_trial
from s2r_sim.score import true_joint

ASKED = 0.10


def row(delta: float | None = 0.03, stage: str | None = None, number: int = 0, **terms: float):
    """A drawer that ended ``delta`` short of the 10 cm asked for, by a motion that fell short unless terms say else."""
    usual = {
        "plan": 0.0,
        "state": 0.0,
        "look": 0.0,
        "joint": 0.0,
        "corrections_left": True,
        "no_correction": False,
    }
    told = {**usual, **terms}
    if delta is not None:
        told.setdefault("motion", delta - told["plan"] - told["state"])
    return {
        "kind": "drawer", "number": number, "change": ASKED, "delta": delta, "delta_first": delta, "stage": stage,
        "reason": "so", "manipulations": 1, "terms": None if delta is None else told,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("trial", "owed_to"),
    [
        (row(0.009), None),
        (row(-0.009, look=-0.009), None),
        (row(), "execute"),
        (row(-0.03), "execute"),
        (row(plan=0.02), "plan"),
        (row(state=0.02), "perceive"),
        (row(plan=-0.04, state=0.02), "execute"),
        (row(look=0.016), "measure"),
        (row(-0.03, look=-0.016), "measure"),
        (row(look=0.014), "execute"),
        (row(look=-0.03), "execute"),
        (row(look=0.03, corrections_left=False), "execute"),
        (row(no_correction=True), "plan"),
        (row(look=0.03, no_correction=True), "measure"),
        (row(joint=0.016, look=0.03), "perceive"),
        (row(joint=-0.03), "execute"),
        (row(None, "plan"), "plan"),
        (row(None, "first push not reachable"), "perceive"),
        (row(None, "estimate joint"), "perceive"),
        (row(None, "view B"), "perceive"),
        (row(None, "physics after targets"), "perceive"),
        (row(0.03, "lost motion after target"), "perceive"),
        (row(None, "home"), "execute"),
        (row(None, "connect"), "processes"),
        (row(0.03, "manipulation"), "execute"),
        (row(0.03, "measure"), "measure"),
        (row(None, "processes"), "processes"),
        (row(None, "between stages"), "processes"),
        (row(0.005, "measure"), None),
    ],
)
def test_a_miss_is_owed_to_the_first_rule_that_holds(trial, owed_to):
    assert stage_of_miss(trial) == owed_to


def test_misses_of_rows_without_terms_are_counted_as_not_told(tmp_path):
    old = {key: value for key, value in row().items() if key != "terms"}
    rows = [row(0.001), row(number=1), row(plan=0.02, number=2), old, row(None, "plan", number=4)]
    assert causes(rows, "drawer").misses == {"execute": 1, "plan": 2, "not told": 1}
    write_page(rows, tmp_path / "page.md", "s2r bench paper", attempts=3)
    text = (tmp_path / "page.md").read_text()
    assert "| object | misses | perceive | plan | execute | measure | processes | not told |" in text
    assert "| drawer | 4 | 0 | 2 | 1 | 0 | 0 | 1 |" in text
    assert "went through; the miss: execute" in text


def test_means_have_intervals_that_hold_them_and_shrink_with_the_trials(tmp_path):
    rows = [row(delta, number=k) for k, delta in enumerate((0.001, 0.002, 0.003, 0.006))]
    one, many = merit(rows, "drawer"), merit(rows * 20, "drawer")
    assert one.delta_90 is not None
    assert many.delta_90 is not None
    assert one.delta == pytest.approx(0.003)
    assert one.delta_90[0] < 0.003 < one.delta_90[1]
    assert one.delta_r_90 == pytest.approx(np.divide(one.delta_90, ASKED))
    assert many.delta_90[1] - many.delta_90[0] < 0.5 * (one.delta_90[1] - one.delta_90[0])
    write_page(rows, tmp_path / "page.md", "s2r bench paper", attempts=3)
    low, high = (f"{100 * value:.2f}" for value in one.delta_90)
    assert f"| 0.30 cm ({low} to {high}) |" in (tmp_path / "page.md").read_text()


def run_of(trial, attempts, way=1.0, hinge_off=(0.0, 0.0, 0.0), touched=None):
    """``run.json`` of a host that tells the joint along ``way`` times the true one, ``hinge_off`` [m] beside it."""
    origin, direction = true_joint(trial.world)
    joint = {
        "joint_type": "prismatic" if trial.kind == "drawer" else "revolute",
        "axis_origin_m": (origin + hinge_off).tolist(),
        "axis_direction": (way * direction).tolist(),
    }
    return {
        "attempts": [
            dict(zip(("tick_start", "s_initial", "s_target", "s_planned", "s_final"), entry, strict=True))
            for entry in attempts
        ],
        "joint": joint,
        "push": {"contact_m": (origin if touched is None else touched).tolist()},
        "inputs": {"settings": {"attempts": 3}},
        "stages": [{"name": "measure 2", "failed": False}],
    }


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_terms_of_delta_sum_up_to_it(way):
    """A host that counts from 5.0 and asks for 0.1: the first manipulation goes 0.06, the second 0.02 of that."""
    trial, s = draw_trial("drawer", 5350), 0.2
    attempts = [(10, 5.0, 5.1, 5.1, 5.07), (20, 5.07, 5.1, 5.09, 5.095)]
    begun, end = [s, s + way * 0.06], s + way * 0.08
    terms = terms_of_error(trial.world, run_of(trial, attempts, way), begun, end, 0.1, s)
    assert terms["plan"] == pytest.approx(0.01)  # 5.10 asked for, 5.09 foreseen
    assert terms["state"] == pytest.approx(0.01)  # 5.07 seen, 5.06 true
    assert terms["motion"] == pytest.approx(0.0)  # 0.02 foreseen and done
    assert terms["look"] == pytest.approx(0.015)  # 5.095 seen, 5.08 true
    assert terms["plan"] + terms["state"] + terms["motion"] == pytest.approx(0.1 - 0.08)
    assert terms["joint"] == pytest.approx(0.0)
    assert terms["corrections_left"]
    assert not terms["no_correction"]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_hinge_told_on_the_circle_of_the_touched_point_reads_half_of_every_turn(way):
    """Inscribed and central angle over one chord."""
    trial = draw_trial("faucet", 5350)
    origin, direction = true_joint(trial.world)
    arm = 0.06 * np.cross(direction, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(direction, [1.0, 0.0, 0.0]))
    # By the second push, which came to the part where the first had left it.
    touched = trial.world.object.q_start + 0.4
    attempts = [(10, 5.0, 5.1, 5.1, 5.07)]
    for off, share in ((np.zeros(3), 0.0), (0.03 * direction, 0.0), (-arm, -0.5)):
        run = run_of(trial, attempts, way, off, origin + arm)
        terms = terms_of_error(trial.world, run, [touched], touched + 0.2, 0.3, touched)
        assert terms["joint"] == pytest.approx(share * way * 0.2, abs=1e-9)


def test_a_plan_for_a_correction_that_was_not_found_is_told():
    trial = draw_trial("drawer", 5350)
    run = run_of(trial, [(10, 5.0, 5.1, 5.1, 5.07)])
    run["stages"] += [{"name": "plan 2", "failed": True}]
    run["inputs"]["settings"]["attempts"] = 1
    terms = terms_of_error(trial.world, run, [0.2], 0.26, 0.1, 0.2)
    assert terms["no_correction"]
    assert not terms["corrections_left"]
    assert json.loads(json.dumps(terms)) == terms
