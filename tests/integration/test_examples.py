"""Every example runs as its README says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("s2r_executor._native", reason="the native core is not built")
pytest.importorskip("mujoco", reason="the stand-in needs mujoco")

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.slow]


def run(*arguments):
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_1_moves_and_tells_the_following_error(tmp_path):
    assert "largest following error" in run("examples/1_move.py")


def test_3_runs_on_the_stand_in_and_2_reads_what_it_recorded(tmp_path):
    pytest_here = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "--basetemp", tmp_path / "t")
    out = run(*pytest_here, "examples/3_test_your_arm.py")
    assert "5 passed" in out, out
    recording = max(tmp_path.glob("t/*/standin/recordings/plan-*.mcap"), key=lambda p: p.stat().st_size)
    assert "joint states over" in run("examples/2_read_a_recording.py", str(recording))


def test_every_example_is_in_the_readme():
    text = (ROOT / "examples/README.md").read_text()
    for path in (ROOT / "examples").glob("*.py"):
        assert path.name in text
