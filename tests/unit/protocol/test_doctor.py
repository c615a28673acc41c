"""`s2r doctor`: findings with a fix, and a code a script can use."""

import json
from dataclasses import replace

import pytest
import yaml
from click.testing import CliRunner

from s2r_protocol.arms import load_arm
from s2r_protocol.cli import doctor as module
from s2r_protocol.exits import UsageError
from s2r_protocol.machine import Level
from s2r_protocol.machine.realtime import read_facts


def test_every_problem_and_note_comes_with_a_fix():
    for finding in module.check_machine():
        assert finding.level in ("ok", "note", "problem")
        assert finding.level == "ok" or finding.fix, finding


def test_a_machine_without_the_interface_is_not_ready_for_it():
    result = CliRunner().invoke(module.doctor, ["--bus", "can:nosuch0", "--json"], standalone_mode=False)
    assert result.return_value == 3
    findings = {f["topic"]: f for f in json.loads(result.output)}
    assert findings["CAN nosuch0"]["level"] == "problem"


def test_only_a_can_bus_can_be_judged():
    with pytest.raises(UsageError, match=r"--bus unix:/tmp/x: expected can:INTERFACE"):
        module.check_machine("unix:/tmp/x")


@pytest.mark.parametrize(("bus", "level"), [("", "note"), ("can:can0", "problem")])
def test_missing_real_time_rights_matter_on_hardware_only(monkeypatch, bus, level):
    facts = replace(read_facts(), fifo="Operation not permitted")
    monkeypatch.setattr(module, "read_facts", lambda interface: facts)
    findings = {f.topic: f for f in module.check_machine(bus)}
    assert findings["FIFO priority"].level == findings["preflight"].level == level
    assert findings["preflight"].text.startswith("REFUSED")


def test_certificates_are_made_and_listed(tmp_path):
    arguments = ["--make-certs", str(tmp_path / "lab"), "--name", "arm.lab", "--json"]
    result = CliRunner().invoke(module.doctor, arguments, standalone_mode=False)
    assert result.return_value == 0
    topics = [f["topic"] for f in json.loads(result.output)]
    assert topics == ["authority", "host", "executor", "camera", "monitor", "next"]
    assert sorted(p.name for p in (tmp_path / "lab").iterdir())[:3] == ["ca.key", "ca.pem", "camera.key"]


def test_the_shipped_arm_is_complete():
    result = CliRunner().invoke(module.doctor, ["--arm", "xmate3pro", "--json"], standalone_mode=False)
    assert result.return_value == 0
    findings = {f["topic"]: f for f in json.loads(result.output)}
    assert findings["model hash"]["text"] == load_arm("xmate3pro").model_hash.hex()


def test_limits_in_degrees_are_a_problem(tmp_path):
    raw = yaml.safe_load((load_arm("xmate3pro").directory / "arm.yaml").read_text())
    raw["joints"][2]["q"] = [-170.0, 170.0]
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(raw))
    findings = {f.topic: f for f in module.check_arm(load_arm(tmp_path))}
    assert findings["angles"].level == Level.PROBLEM
    assert "170 rad ('joint3')" in findings["angles"].text
    assert findings["angles"].fix == "angles are radians, not degrees"


def test_every_limit_that_the_bus_cannot_carry_is_told_with_its_joint_and_unit(tmp_path):
    raw = yaml.safe_load((load_arm("xmate3pro").directory / "arm.yaml").read_text())
    raw["joints"][0]["dq_max"] = 180.0
    raw["joints"][4]["dq_max"] = 1e-4
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(raw))
    findings = {f.topic: f for f in module.check_arm(load_arm(tmp_path)) if f.level == Level.PROBLEM}
    assert sorted(findings) == ["joint1.dq_max", "joint5.dq_max"]
    told = findings["joint1.dq_max"]
    assert told.text.startswith(
        "joint 'joint1' (index 0): dq_max = 180 rad/s is outside [0.001, 6.5534] rad/s"
    )
    assert told.fix == "degrees? 180°/s are 3.142 rad/s"
    assert "degrees" not in findings["joint5.dq_max"].fix


def test_an_arm_without_a_named_fingertip_is_told_what_to_do(tmp_path):
    raw = yaml.safe_load((load_arm("xmate3pro").directory / "arm.yaml").read_text())
    raw["shapes"] = [s for s in raw["shapes"] if not s["name"].startswith("finger_") and s["link"] != "link5"]
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(raw))
    result = CliRunner().invoke(module.doctor, ["--arm", str(tmp_path), "--json"], standalone_mode=False)
    assert result.return_value == 2
    problems = {f["topic"]: f for f in json.loads(result.output) if f["level"] == "problem"}
    assert "'finger'" in problems["fingertip"]["text"]
    assert problems["shapes"]["text"] == "no collision shape on: link5"
