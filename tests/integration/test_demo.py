"""`s2r demo` as a process: what a terminal, a script or a service manager does to it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from s2r_protocol.exits import ExitCode


def processes_of(folder):
    """Running processes whose command line names the folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                line = (entry / "cmdline").read_bytes()
            except OSError:  # it ended while we looked
                continue
            if str(folder).encode() in line:
                found.append(entry.name)
    return found


def test_a_demo_that_is_terminated_leaves_no_process_behind(tmp_path):
    out = tmp_path / "demo"
    command = [sys.executable, "-m", "s2r_protocol", "demo", "--out", str(out), "--pace", "0"]
    demo = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert demo.stderr is not None
    for line in demo.stderr:
        if "connect" in line:  # the host's first stage: all three processes are up
            break
    demo.send_signal(signal.SIGTERM)
    assert "interrupted" in demo.communicate(timeout=600)[1]
    assert demo.returncode == ExitCode.INTERRUPTED
    deadline = time.monotonic() + 300
    while processes_of(out):
        assert time.monotonic() < deadline, processes_of(out)
        time.sleep(0.1)


def test_a_demo_refuses_a_folder_that_holds_something(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    command = [sys.executable, "-m", "s2r_protocol", "demo", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == ExitCode.USAGE
    assert "is not empty" in done.stderr


def test_another_arm_opens_a_drawer_from_its_description_alone(tmp_path):
    out = tmp_path / "demo"
    command = [sys.executable, "-m", "s2r_protocol", "demo", "--out", str(out), "--pace", "0"]
    command += ["--arm", str(Path(__file__).parents[1] / "unit/host/six_joint_arm"), "--seed", "3"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == ExitCode.OK, done.stderr
    verdict = json.loads((out / "demo.json").read_text())
    assert abs(verdict["delta_true"]) < 0.005
    assert len(json.loads((out / "run/run.json").read_text())["attempts"]) >= 1


def test_an_arm_that_is_not_there_is_refused_before_anything_starts(tmp_path):
    command = [
        sys.executable,
        "-m",
        "s2r_protocol",
        "demo",
        "--out",
        str(tmp_path / "demo"),
        "--arm",
        "spoon",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == ExitCode.USAGE, done.stderr
    assert "spoon" in done.stderr


def test_a_demo_refuses_an_absurd_target_before_anything_starts(tmp_path):
    out = tmp_path / "demo"
    command = [sys.executable, "-m", "s2r_protocol", "demo", "--out", str(out)]
    for option in ("--target=5m", "--then=30deg"):
        done = subprocess.run([*command, option], capture_output=True, text=True, timeout=600)
        assert done.returncode == ExitCode.USAGE
        assert option.split("=")[0] in done.stderr
        assert not out.exists()
