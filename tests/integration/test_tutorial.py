"""The tutorial's commands, taken from its page and run as printed; and the reference names everything there is."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from s2r_executor.cli_config import flat
from s2r_executor.config import ExecutorConfig
from s2r_protocol.cli.commands import COMMANDS
from s2r_protocol.ros2.definitions import all_names

ROOT = Path(__file__).parents[2]
_BLOCK = re.compile(r"^```sh\n(.*?)^```", re.M | re.S)


def commands(page):
    return [line for block in _BLOCK.findall(page.read_text()) for line in block.splitlines() if line.strip()]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_every_command_of_the_tutorial_works_as_printed(tmp_path):
    pytest.importorskip("s2r_executor._native", reason="the native core is not built")
    lines = commands(ROOT / "docs/tutorial.md")
    assert len(lines) >= 8
    binaries = tmp_path / "bin"
    binaries.mkdir()
    script = binaries / "s2r"
    script.write_text(f'#!/bin/sh\nexec {sys.executable} -m s2r_protocol "$@"\n')
    script.chmod(0o755)
    path = os.pathsep.join([str(binaries), os.environ["PATH"]])
    for line in lines:
        done = subprocess.run(
            ["bash", "-c", line],
            cwd=tmp_path,
            env={**os.environ, "PATH": path},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"$ {line}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
    tutorial = tmp_path / "runs/tutorial"
    for made in ("run/report.html", "view.html", "again/replay.html", "tables/joint_states.parquet"):
        assert (tutorial / made).stat().st_size > 1000, made
    assert (tutorial / "slow/replay-2.mcap").exists()
    assert "http" not in re.sub(r"http://www\.w3\.org", "", (tutorial / "again/replay.html").read_text())


def test_the_reference_names_every_command_key_and_message(tmp_path):
    subprocess.run([sys.executable, ROOT / "scripts/generate-reference", tmp_path], check=True, timeout=600)
    text = (tmp_path / "cli.md").read_text()
    for name in COMMANDS:
        assert f"## s2r {name}\n" in text
    text = (tmp_path / "config.md").read_text()
    for key in flat(ExecutorConfig().model_dump(mode="json")):
        assert f"`{key}`" in text
    text = (tmp_path / "messages.md").read_text()
    for name in all_names():
        assert f"## {name}\n" in text


def test_the_site_builds_and_needs_no_network(tmp_path):
    mkdocs = Path(sys.executable).with_name("mkdocs")
    if not mkdocs.exists():
        pytest.skip("mkdocs-material is not installed")
    subprocess.run([mkdocs, "build", "--quiet", "--site-dir", tmp_path], cwd=ROOT, check=True, timeout=600)
    for page in ("index.html", "tutorial.html", "how-to/console.html", "reference/cli.html"):
        html = (tmp_path / page).read_text()
        wanted = re.findall(
            r'<(?:script|img)[^>]+src="(https?:)?//|<link[^>]+stylesheet[^>]+href="https?://', html
        )
        assert not wanted, f"{page} loads something from a network"
