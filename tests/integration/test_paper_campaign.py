"""The accuracy campaign as a command: six manipulations through the whole system, scored, and continued."""

import json
import subprocess
import sys

import pytest

from s2r_protocol.exits import ExitCode


@pytest.mark.prove
@pytest.mark.timeout(7200)
def test_six_manipulations_are_run_scored_and_not_run_again(tmp_path):
    command = [
        sys.executable,
        "-m",
        "s2r_protocol",
        "bench",
        "paper",
        "--trials",
        "2",
        "--out",
        str(tmp_path),
        "--json",
    ]
    first = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = (tmp_path / "results.jsonl").read_text()
    rows = [json.loads(line)["result"] for line in lines.splitlines()]
    assert sorted({row["kind"] for row in rows}) == ["drawer", "faucet", "laptop"]
    assert len(rows) == 6
    for row in rows:
        assert row["exit"] != ExitCode.BUG, row
        assert row["commitment_holds"], row
        assert row["stage"] is not None or row["delta"] is not None, row
    assert sum(entry["done"] for entry in json.loads(first.stdout)["last"]) >= 2  # the drawers at least
    again = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(again.stdout) == json.loads(first.stdout)
    assert (tmp_path / "results.jsonl").read_text() == lines
