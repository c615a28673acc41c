"""``s2r plan`` answers whatever its planner does: it takes too long, dies, says nothing, or is not wanted any more."""

import json
import signal
import sys
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from s2r_host import plan_process
from s2r_host.cli_plan import plan
from s2r_host.plan_process import PlanOrder, plan_in_process
from s2r_protocol.exits import ExitCode, S2RError, UsageError

# A planner that says where it is, and then does what the test wants.
START = """
import json, os, signal, sys, time
order = json.load(sys.stdin)
def say(**line):
    print(json.dumps(line), flush=True)
say(doing="attempt 1, step 3", control_steps=3)
"""


def order(out, limit_s=3600.0):
    return PlanOrder("room.xml", "tap", 0.5, None, "xmate3pro", None, None, str(out), 7, limit_s, 1, ())


def planner(text):
    return sys.executable, "-c", START + text


def refused(out, text, limit_s=3600.0):
    """The error and ``plan.json`` when a planner does something else than planning."""
    with pytest.raises((S2RError, RuntimeError)) as caught:
        plan_in_process(order(out, limit_s), lambda doing: None, planner(text))
    answer = json.loads((out / "plan.json").read_text())
    assert answer["reason"] == str(caught.value)
    assert answer["success"] is False
    assert answer["held"] is False
    assert answer["seed"] == 7
    assert answer["target"] == 0.5
    assert answer["wall_s"] > 0.0
    return caught.value, answer


def test_a_planner_that_never_looks_at_the_clock_is_ended_after_the_time_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(plan_process, "GRACE_S", 0.2)
    error, answer = refused(tmp_path, "time.sleep(3600)", limit_s=1.0)
    assert str(error) == "no plan within the time limit of 1 s; given up at: attempt 1, step 3"
    assert error.exit_code == ExitCode.REFUSED
    assert answer["control_steps"] == 3


def test_nothing_of_half_a_plan_stays_when_the_planner_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(plan_process, "GRACE_S", 0.0)
    monkeypatch.setattr(plan_process, "_WRITING_S", 0.5)
    refused(
        tmp_path,
        "say(doing='writing the files', control_steps=9)\n"
        "open(os.path.join(order['out'], 'plan.csv'), 'w').write('t')\ntime.sleep(3600)",
        limit_s=1.0,
    )
    assert not (tmp_path / "plan.csv").exists()


def test_a_planner_that_is_writing_its_files_may_finish_after_the_time_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(plan_process, "GRACE_S", 0.0)
    text = "say(doing='writing the files', control_steps=9)\ntime.sleep(1.5)\nsay(answer={'success': True})"
    assert plan_in_process(order(tmp_path, 1.0), lambda doing: None, planner(text)) == {"success": True}


def test_an_old_answer_does_not_outlive_a_new_request(tmp_path):
    (tmp_path / "plan.json").write_text("old")
    (tmp_path / "plan.csv").write_text("old")
    error, _ = refused(tmp_path, "say(refused='joint 7: no', exit_code=4)")
    assert error.exit_code == ExitCode.REFUSED
    assert not (tmp_path / "plan.csv").exists()


def test_a_refusal_that_the_planner_has_written_itself_is_kept(tmp_path):
    text = (
        "open(os.path.join(order['out'], 'plan.json'), 'w').write('{\"reason\": \"mine\"}')\n"
        "say(refused='no', exit_code=2)"
    )
    with pytest.raises(S2RError, match="no") as caught:
        plan_in_process(order(tmp_path), lambda doing: None, planner(text))
    assert caught.value.exit_code == ExitCode.USAGE
    assert json.loads((tmp_path / "plan.json").read_text()) == {"reason": "mine"}


def test_a_planner_that_the_operating_system_ends_is_told_apart_from_a_bug(tmp_path):
    error, _ = refused(tmp_path, "os.kill(os.getpid(), signal.SIGKILL)")
    assert "most likely memory ran out" in str(error)
    assert error.exit_code == ExitCode.NOT_READY


def test_a_planner_that_crashes_in_its_native_part_is_a_bug_and_leaves_an_answer(tmp_path):
    error, _ = refused(tmp_path, "signal.signal(signal.SIGABRT, signal.SIG_DFL); os.abort()")
    assert isinstance(error, RuntimeError)
    assert str(error) == "bug in the planner: it ended with signal SIGABRT at: attempt 1, step 3"


def test_a_planner_that_has_just_ended_is_taken_leave_of_once(tmp_path):
    child = plan_process._Child(order(tmp_path), lambda doing: None, planner(""))
    child.start()
    process = child._process
    assert process is not None
    stat = Path(f"/proc/{process.pid}/stat")
    until = time.monotonic() + 30.0
    while stat.read_text().rpartition(")")[2].split()[0] != "Z" and time.monotonic() < until:
        time.sleep(0.01)
    assert child.end() > 0.0
    assert process.returncode == 0
    assert child.end() > 0.0


def test_a_bug_that_the_planner_tells_is_in_the_answer(tmp_path):
    error, _ = refused(tmp_path, "say(bug='ValueError: 3')")
    assert str(error) == "bug in the planner: ValueError: 3"


def test_ctrl_c_ends_the_planner_and_leaves_an_answer(tmp_path):
    pid_file = tmp_path / "pid"

    def tell(doing):
        def press():
            deadline_s = time.monotonic() + 300
            while not pid_file.exists() and time.monotonic() < deadline_s:
                time.sleep(0.02)
            signal.raise_signal(signal.SIGINT)

        threading.Thread(target=press).start()

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            plan_in_process(
                order(tmp_path),
                tell,
                planner(
                    f"p = {str(pid_file)!r}\nwith open(p + '_', 'w') as file:\n    file.write(str(os.getpid()))\n"
                    "os.rename(p + '_', p)\ntime.sleep(3600)"
                ),
            )
    finally:
        signal.signal(signal.SIGINT, before)
    answer = json.loads((tmp_path / "plan.json").read_text())
    assert answer["reason"].startswith("interrupted after ")
    assert answer["reason"].endswith("at: attempt 1, step 3")
    assert not Path(f"/proc/{pid_file.read_text()}").exists()


def test_the_command_refuses_with_the_planners_sentence_exit_code_and_answer(tmp_path):
    options = ["--scene", str(tmp_path / "none.xml"), "--joint", "tap", "--target", "0.5"]
    result = CliRunner().invoke(plan, [*options, "--out", str(tmp_path / "out"), "--json"])
    assert result.exit_code == ExitCode.USAGE
    assert "none.xml: no such file" in result.stderr
    assert "none.xml: no such file" in json.loads(result.stdout)["reason"]


def test_a_time_limit_that_is_no_number_is_refused(tmp_path):
    options = ["--scene", "x.xml", "--joint", "tap", "--target", "1", "--out", str(tmp_path)]
    result = CliRunner().invoke(plan, [*options, "--time-limit", "nan"], standalone_mode=False)
    assert "'--time-limit': nan is not a finite number" in result.exception.format_message()


def test_a_target_that_is_no_number_is_refused(tmp_path):
    options = ["--scene", "x.xml", "--joint", "tap", "--out", str(tmp_path)]
    for target, words in (("nan", "--target nan is not finite"), ("wide", "--target 'wide' is not a number")):
        result = CliRunner().invoke(plan, [*options, "--target", target], standalone_mode=False)
        assert isinstance(result.exception, UsageError)
        assert words in str(result.exception)


def test_a_plan_does_not_replace_a_table_of_somebody_else(tmp_path):
    (tmp_path / "plan.csv").write_text("mine")
    words = ["--scene", "none.xml", "--joint", "j", "--target", "0.1", "--json", "--out", str(tmp_path)]
    ended = CliRunner().invoke(plan, words)
    assert isinstance(ended.exception, UsageError)
    assert "holds plan.csv, not written by this command" in str(ended.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["plan.csv"]
    assert (tmp_path / "plan.csv").read_text() == "mine"
