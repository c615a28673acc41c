"""The accuracy campaign as a command: six manipulations through the whole system, scored, told and not run again; and
what a run of it leaves is read by others and replayed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from s2r_host.recording import joint_track
from s2r_protocol.cli.peers import s2r_command, stand_in_cell
from s2r_protocol.exits import ExitCode
from s2r_sim.score import read_truth, sense
from s2r_sim.world import load_world

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]
FIRST = 5350
TRIALS = [(kind, number) for number in (FIRST, FIRST + 1) for kind in ("drawer", "laptop", "faucet")]


@dataclass(frozen=True)
class Campaign:
    """A campaign that was run: its command, what that printed, its folder and its rows by kind and number."""

    command: list[str]
    said: dict[str, Any]
    folder: Path
    rows: dict[tuple[str, int], dict[str, Any]]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """One planned manipulation each, which is what the paper measures."""
    folder = tmp_path_factory.mktemp("campaign")
    command = s2r_command(
        "bench", "paper", "--trials", "2", "--first", str(FIRST), "--attempts", "1", "--jobs", "2",
        "--out", folder, "--json",
    )  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000)
    assert done.returncode == ExitCode.OK, done.stderr
    lines = (folder / "results.jsonl").read_text().splitlines()
    rows = [json.loads(line)["result"] for line in lines]
    return Campaign(
        command, json.loads(done.stdout), folder, {(row["kind"], row["number"]): row for row in rows}
    )


def test_six_manipulations_go_through_or_name_the_stage_that_failed(campaign):
    assert sorted(campaign.rows) == sorted(TRIALS)
    for row in campaign.rows.values():
        assert row["exit"] != ExitCode.BUG, row
        assert row["commitment_holds"], row
        assert row["manipulations"] == 1 if row["stage"] is None else row["stage"], row
    assert [entry["n"] for entry in campaign.said["last"]] == [2, 2, 2]
    first = campaign.said["first"]  # nothing was corrected
    assert [{name: one[name] for name in first[0]} for one in campaign.said["last"]] == first


@pytest.mark.parametrize("kind", ["drawer", "laptop"])
def test_drawers_and_lids_end_within_a_tenth_of_what_was_asked_for(campaign, kind):
    for number in (FIRST, FIRST + 1):
        row = campaign.rows[kind, number]
        assert row["stage"] is None, row
        assert abs(row["delta"]) < 0.1 * abs(row["change"]), row


def test_the_page_tells_every_trial_and_shows_the_distribution(campaign):
    text = (campaign.folder / "results.md").read_text()
    for kind, number in TRIALS:
        assert f"\n| {kind} | {number} | " in text
    assert f"--trials 2 --first {FIRST} --attempts 1" in text
    assert (campaign.folder / "results.png").stat().st_size > 10_000


def test_trials_that_are_done_are_not_run_again(campaign):
    def written():
        return {path: path.stat().st_mtime_ns for path in campaign.folder.rglob("trials/*/*")}

    before, lines = written(), (campaign.folder / "results.jsonl").read_bytes()
    again = subprocess.run(campaign.command, capture_output=True, text=True, timeout=600)
    assert json.loads(again.stdout) == campaign.said
    assert (campaign.folder / "results.jsonl").read_bytes() == lines
    assert len(before) > 6 * 5
    assert written() == before


def test_what_the_host_measured_is_what_the_sealed_truth_says(campaign):
    folder = campaign.folder / f"trials/drawer-{FIRST}"
    run, world = json.loads((folder / "run/run.json").read_text()), load_world(folder / "world.json")
    truth = read_truth(folder / "truth.csv")
    assert run["world_commitment"] == world.commitment
    assert run["world_commitment"] in (folder / "sim-arm.log").read_text().split()
    begun = truth.s_at_tick(run["tick_before_plan"])
    way = sense(world, run)
    assert run["s_initial"] == pytest.approx(way * (begun - truth.s[0]), abs=1.5e-3)
    assert run["s_final"] == pytest.approx(way * (truth.s[-1] - truth.s[0]), abs=1.5e-3)
    assert run["delta_r"] == pytest.approx(run["delta"] / (run["s_target"] - run["s_initial"]))


def test_a_run_is_read_by_others_and_its_motion_replayed_on_the_same_world(campaign, tmp_path):
    folder = campaign.folder / f"trials/drawer-{FIRST}"
    assert "δ = s_target − s_final" in (folder / "run/report.html").read_text()
    assert joint_track(folder / "run/run.mcap").q.shape[1] == 7
    foreign_readers_open(folder / "run/run.mcap")
    with stand_in_cell(tmp_path, ("--world", folder / "world.json")) as cell:
        again = subprocess.run(
            s2r_command(
                "replay", folder / "run", "--real", "--yes", "--executor", cell.executor, "--json", "--plan", "2"
            ),
            capture_output=True, text=True, timeout=600,
        )  # fmt: skip
    assert again.returncode == ExitCode.OK, again.stderr
    assert max(json.loads(again.stdout)["rms_rad"].values()) < 1e-4
    assert (folder / "run/replay-2/overlay.png").stat().st_size > 10_000


def foreign_readers_open(recording):
    """rosbags deserializes every message, Rerun's own check finds nothing wrong; the file is not touched."""
    with AnyReader([recording]) as reader:
        kinds = {type(reader.deserialize(raw, connection.msgtype)).__name__
                 for connection, _, raw in reader.messages()}  # fmt: skip
    assert any("JointState" in kind for kind in kinds), kinds
    rerun = Path(sys.executable).with_name("rerun")
    quiet = {**os.environ, "RERUN_ANALYTICS": "0", "NO_COLOR": "1"}
    done = subprocess.run(
        [rerun, "mcap", "check", recording], env=quiet, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
