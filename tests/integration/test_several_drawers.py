"""A chest whose two drawers both move: the operator says which, and the other stays."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pytest

from s2r_protocol.cli.peers import s2r_command, stand_in_cell
from s2r_protocol.exits import ExitCode
from s2r_sim.objects.catalogue import states_as_found
from s2r_sim.score import read_truth
from s2r_sim.world import draw_world

SEED = 2
TARGET_M = 0.08


def upper_front(chest) -> np.ndarray:
    """Middle of the upper drawer's front, as an operator would read it off a picture [m, base frame]."""
    open_m = chest.q_start if chest.row == 1 else chest.others[0]
    half_turn = np.pi + chest.yaw_rad
    x, y = np.array([chest.x_m, chest.y_m]) + open_m * np.array([np.cos(half_turn), np.sin(half_turn)])
    return np.array([x, y, 0.75 * chest.height_m])


@pytest.mark.slow
def test_the_drawer_that_is_pointed_at_is_opened_and_the_other_stays(tmp_path):
    world = draw_world(SEED, "drawers", salt="test")
    assert len(states_as_found(world.object)) == 2
    world.save(tmp_path / "world.json")
    at = ",".join(f"{value:.2f}" for value in upper_front(world.object))
    truth_file = tmp_path / "truth.csv"
    with stand_in_cell(
        tmp_path, ("--world", tmp_path / "world.json"), stand_in=("--truth", truth_file)
    ) as cell:
        command = s2r_command(
            "run", "drawer", f"--target={TARGET_M}", "--at", at, "--acknowledge-contact",
            "--executor", cell.executor, "--camera", cell.camera, "--out", tmp_path / "run",
        )  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == ExitCode.OK, done.stderr
    truth = read_truth(truth_file)
    opened = truth.of_moved(int(truth.master_tick[0]))
    upper = truth.s if world.object.row == 1 else truth.others[:, 0]
    assert opened.s[-1] == upper[-1]
    assert opened.s[-1] - opened.s[0] == pytest.approx(TARGET_M, abs=0.005)
    assert np.abs(opened.others - opened.others[0]).max() < 0.001
    model = (tmp_path / "run/model/believed.xml").read_text()
    assert "neighbour_0" in model


@pytest.mark.slow
def test_a_point_beside_the_object_is_refused_and_nothing_moves(tmp_path):
    with stand_in_cell(tmp_path, ("--seed", str(SEED), "--kind", "drawers")) as cell:
        command = s2r_command(
            "run", "drawer", "--target", "80mm", "--at", "0.4,0.5,0.1",
            "--executor", cell.executor, "--camera", cell.camera, "--out", tmp_path / "run",
        )  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == ExitCode.REFUSED, done.stderr
    values = json.loads((tmp_path / "run/run.json").read_text())
    assert "within 8 cm of --at 0.40,0.50,0.10" in values["exit"]["reason"]
    assert values["push"] is None
