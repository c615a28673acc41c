"""Committed generated files are what `scripts/generate` makes today."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    out = tmp_path_factory.mktemp("generated")
    environment = {"PYTHON": sys.executable, "PATH": "/usr/bin:/bin"}
    subprocess.run([ROOT / "scripts/generate", out], check=True, cwd=ROOT, env=environment, timeout=600)
    return out


def test_generated_files_are_current(fresh):
    made = sorted(p.relative_to(fresh) for p in fresh.rglob("*") if p.is_file())
    assert len(made) >= 5
    for path in made:
        assert (ROOT / path).read_text() == (fresh / path).read_text(), (
            f"{path} is stale: run scripts/generate"
        )
