"""The tool and what hides the answers from it are kept apart while they run, too, not only in the sources."""

import json
import os
import subprocess
import sys

import pytest

from s2r_conceal.kept_away import without_concealment
from s2r_conceal.run import run_case
from s2r_host.gap.rig import Drive, Secret, write_case

TOOL = """
import json, os, subprocess, sys
from pathlib import Path

try:
    import s2r_conceal.seal
    found = "imported"
except ModuleNotFoundError as error:
    found = str(error)
import s2r_protocol
child = subprocess.run([sys.executable, "-c", "import s2r_conceal"], capture_output=True)
out = Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir()
(out / "gap.json").write_text(json.dumps({"verdict": found, "child": child.returncode, "beside": os.listdir()}))
"""
LOADED = """
import sys
from s2r_protocol.cli.root import main
try:
    main(sys.argv[1:])
except SystemExit as ended:
    code = ended.code
print(code, *(name for name in sys.modules if name.startswith("s2r_conceal")))
"""


@pytest.fixture
def case(tmp_path):
    return write_case(tmp_path / "case", Secret(), Drive(duration_s=2.0))


def test_an_examined_tool_and_its_workers_cannot_import_the_concealment(tmp_path, case):
    (tmp_path / "verdicts").mkdir()
    script = tmp_path / "tool.py"
    script.write_text(TOOL)
    run_case(tmp_path, "case", [sys.executable, str(script)], 60.0, {})
    answer = json.loads((tmp_path / "verdicts/case.json").read_text())["gap"]
    assert answer["verdict"] == "s2r_conceal is kept away from the tool that is examined"
    assert answer["child"] != 0
    assert not [name for name in answer["beside"] if "kept" in name]


def test_running_the_tool_loads_nothing_of_the_concealment(tmp_path, case):
    config = tmp_path / "gap.yaml"
    config.write_text("{simulate: false, report: false}")
    arguments = [
        "gap",
        "--model",
        case["model"],
        "--fit",
        case["fit"],
        "--config",
        config,
        "--out",
        tmp_path / "out",
    ]
    ended = subprocess.run(
        [sys.executable, "-c", LOADED, *map(str, arguments)], capture_output=True, text=True, check=True
    )
    code, *loaded = ended.stdout.split()
    assert code in ("0", "7"), ended.stderr
    assert not loaded


def test_what_was_on_the_path_stays_there(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    with without_concealment() as surroundings:
        folder, *rest = surroundings["PYTHONPATH"].split(os.pathsep)
        assert rest == ["/somewhere"]
        assert os.listdir(folder) == ["sitecustomize.py"]
    assert not os.path.exists(folder)
