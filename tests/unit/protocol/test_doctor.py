"""`s2r doctor`: findings with a fix, and a code a script can use."""

import json

import yaml
from click.testing import CliRunner

from s2r_protocol.arms import load_arm
from s2r_protocol.cli import doctor as module


def test_every_problem_and_note_comes_with_a_fix():
    for finding in module.check_machine():
        assert finding.level in ("ok", "note", "problem")
        assert finding.level == "ok" or finding.fix, finding


def test_a_missing_base_package_is_a_problem(monkeypatch):
    monkeypatch.setattr(module, "_is_installed", lambda name: name != "zenoh")
    base = next(f for f in module.check_machine() if f.topic == "packages: base")
    assert (base.level, base.fix) == ("problem", "pip install 'sim2real2'")
    assert "zenoh" in base.text


def test_the_shipped_arm_is_complete():
    result = CliRunner().invoke(module.doctor, ["--arm", "xmate3pro", "--json"], standalone_mode=False)
    assert result.return_value == 0
    findings = {f["topic"]: f for f in json.loads(result.output)}
    assert findings["model hash"]["text"] == load_arm("xmate3pro").model_hash.hex()


def test_an_arm_without_a_named_fingertip_is_told_what_to_do(tmp_path):
    raw = yaml.safe_load((load_arm("xmate3pro").directory / "arm.yaml").read_text())
    raw["shapes"] = [s for s in raw["shapes"] if not s["name"].startswith("finger_") and s["link"] != "link5"]
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(raw))
    result = CliRunner().invoke(module.doctor, ["--arm", str(tmp_path), "--json"], standalone_mode=False)
    assert result.return_value == 2
    problems = {f["topic"]: f for f in json.loads(result.output) if f["level"] == "problem"}
    assert "finger_*" in problems["fingertip"]["text"]
    assert problems["shapes"]["text"] == "no collision shape on: link5"
