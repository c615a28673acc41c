"""Who gets through the console's front door, and who may do what behind it."""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh

from s2r_host.console.feed import Feed, Health
from s2r_host.console.gate import Address, ConsoleAddressError, Gate, Request, judge
from s2r_host.console.jobs import Jobs
from s2r_host.console.live_run import RunWatch, cloud_of, sight_of
from s2r_host.console.operator import NoControlError, Operator
from s2r_host.console.run_index import RunIndex
from s2r_host.console.screens.gap import gap_markup, read_answer
from s2r_host.console.screens.run import _stages
from s2r_host.console.screens.runs import again, joint_value
from s2r_host.console.screens.timing import blame
from s2r_host.errors import RecordingError
from s2r_host.link_camera import Capture
from s2r_host.log.scan import Scan
from s2r_host.log.tables import EXECUTOR_STATE, JOINT_STATE, TRAJECTORY
from s2r_host.perception.frames import DepthFrame
from s2r_host.recording import RunRecorder
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import NotReadyError, RefusedError
from s2r_protocol.keys import ArmKeys
from s2r_protocol.ros2 import pack
from s2r_protocol.session.certificates import make_certificates

TOKEN = "0123456789abcdef"
LAN = Address("0.0.0.0", 7450, TOKEN)
LOCAL = Address("127.0.0.1", 7450)
RUN = {
    "task": "drawer", "s_target": 0.1, "delta": None, "verdicts": [], "wall_s": 1.0,
    "arm": {"name": "a"}, "exit": {"code": 0, "name": "OK", "reason": ""},
    "inputs": {"settings": {"seed": 0}, "arguments": []},
}  # fmt: skip


def request(target="/", **headers):
    return Request(target, {name.replace("_", "-"): value for name, value in headers.items()})


def status_of(verdict):
    return verdict[1].split(b"\r\n")[0].decode()


def test_beyond_loopback_a_token_is_demanded_at_the_start():
    with pytest.raises(ConsoleAddressError, match="--token-file"):
        Address("192.168.1.5", 7450)
    with pytest.raises(ConsoleAddressError, match="needs at least 16"):
        Address("192.168.1.5", 7450, "short")


def test_an_address_of_another_machine_is_not_taken_for_a_second_console():
    with pytest.raises(NotReadyError, match="name an address of this machine with --host"):
        Gate(Address("192.0.2.1", 0, TOKEN), 1)


def test_a_run_that_cannot_be_read_is_told_once_and_read_again_when_it_has_changed(tmp_path, caplog):
    broken = tmp_path / "a" / "run.json"
    broken.parent.mkdir()
    broken.write_text("{")
    index = RunIndex(tmp_path)
    for _ in range(3):
        index.refresh()
    assert len(caplog.records) == 1
    broken.write_text("{}")
    os.utime(broken, (1, 1))
    index.refresh()
    assert len(caplog.records) == 2
    index.close()


def test_a_second_console_on_the_same_port_says_so_and_ends():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        command = [sys.executable, "-m", "s2r_protocol", "console", "--executor", "tcp/127.0.0.1:1"]
        run = subprocess.run(
            [*command, "--port", str(port)], capture_output=True, text=True, timeout=300, check=False
        )
    assert run.returncode == 3, run.stderr
    assert f"cannot listen on 127.0.0.1:{port}" in run.stderr
    assert "Choose another with --port" in run.stderr
    assert "Traceback" not in run.stderr


def console_after(script: str, runs: Path, timeout_s: float) -> subprocess.CompletedProcess[str]:
    """A console in a process of its own that has run a script first."""
    script += (
        "from s2r_protocol.cli.root import main\n"
        "main(['console', '--executor', 'tcp/127.0.0.1:1', '--port', '0', '--runs', sys.argv[1]])\n"
    )
    command = [sys.executable, "-c", script, str(runs)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


def test_an_interrupt_that_an_import_catches_still_ends_the_console(tmp_path):
    """As trimesh does at its optional imports: what is raised there is lost."""
    script = (
        "import os, signal, sys, s2r_host.console.gate as gate\n"
        "def judge(*arguments):\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    except BaseException:\n"
        "        pass\n"
        "    return None\n"
        "gate.Address.__post_init__ = judge\n"
    )
    run = console_after(script, tmp_path, timeout_s=120)
    assert (run.returncode, run.stderr) == (130, "s2r: interrupted\n")


def test_an_interrupt_while_the_page_is_built_ends_it_at_once(tmp_path):
    script = (
        "import os, signal, sys, time, s2r_host.console.app as app\n"
        "def build(console):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    time.sleep(60.0)\n"
        "app.Console._build = build\n"
    )
    run = console_after(script, tmp_path, timeout_s=50)
    assert (run.returncode, run.stderr) == (130, "s2r: interrupted\n")


def test_browsers_that_are_there_when_the_console_ends_raise_no_error(caplog):
    with socket.socket() as inner:
        inner.bind(("127.0.0.1", 0))
        inner.listen()
        with Gate(Address("127.0.0.1", 0), inner.getsockname()[1]) as gate:
            browser = socket.create_connection(("127.0.0.1", gate.port))
            browser.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{gate.port}\r\n\r\n".encode())
            passed, _ = inner.accept()
            assert passed.recv(14) == b"GET / HTTP/1.1"
        assert browser.recv(1) == b""
        browser.close()
        passed.close()
    assert [record.getMessage() for record in caplog.records if record.name == "asyncio"] == []


def test_a_name_is_not_loopback():
    with pytest.raises(ConsoleAddressError):
        Address("robot", 7450)


@pytest.mark.parametrize("target", ["/", "/?token=wrong-wrong-wrong", "/?token="])
def test_without_the_token_nobody_gets_in(target):
    verdict = judge(request(target, host="robot:7450"), LAN)
    assert "401" in status_of(verdict)


def test_the_token_becomes_a_cookie_and_leaves_the_address():
    verdict = judge(request(f"/?token={TOKEN}", host="robot:7450"), LAN)
    assert "303" in status_of(verdict)
    assert b"Location: /\r\n" in verdict[1]
    assert b"HttpOnly; SameSite=Strict" in verdict[1]
    assert judge(request(host="robot:7450", cookie=f"a=b; s2r_token={TOKEN}"), LAN)[0] == "pass"


def test_a_token_of_base64_gets_in_as_it_is_typed():
    token = "q83vEjRW+/eJq83vEjRWeA=="
    address = Address("0.0.0.0", 7450, token)
    assert "303" in status_of(judge(request(f"/?token={token}", host="robot:7450"), address))
    assert judge(request(host="robot:7450", cookie=f"s2r_token={token}"), address)[0] == "pass"


@pytest.mark.parametrize(
    "token", ["0123456789abcdef;", "0123456789 abcdef", "0123456789abcdéf", "0" * 20 + "\r\nX: y"]
)
def test_a_token_with_which_nobody_would_get_in_is_refused(token):
    with pytest.raises(ConsoleAddressError, match="nobody would get in; use letters, digits and"):
        Address("0.0.0.0", 7450, token)


@pytest.mark.parametrize("headers", [{"host": "[::1"}, {"host": "127.0.0.1:7450", "origin": "http://[::1"}])
def test_half_an_address_is_answered(headers):
    assert "400" in status_of(judge(request(**headers), LOCAL))


def test_a_page_from_elsewhere_may_not_use_the_console():
    for address in (LOCAL, LAN):
        headers = {"host": "127.0.0.1:7450", "origin": "http://evil.example", "cookie": f"s2r_token={TOKEN}"}
        assert "403" in status_of(judge(Request("/", headers), address))


def test_a_name_that_was_bent_to_loopback_is_refused():
    assert "403" in status_of(judge(request(host="evil.example:7450"), LOCAL))


def test_the_consoles_own_page_passes_on_loopback():
    assert judge(request(host="127.0.0.1:7450", origin="http://127.0.0.1:7450"), LOCAL) == ("pass", b"")
    assert judge(request(host="localhost:7450"), LOCAL)[0] == "pass"


def test_what_is_no_http_is_told_so():
    assert "400" in status_of(judge(Request.parse(b"\x16\x03\x01 hello\r\n\r\n"), LOCAL))


@pytest.fixture
def operator():
    return Operator("tcp/127.0.0.1:1", load_arm("xmate3pro"), ArmKeys())


def test_without_control_no_command_is_even_tried(operator):
    with pytest.raises(NoControlError, match="Take control"):
        operator.command(3, lambda link: pytest.fail("it was carried out"))
    with pytest.raises(NoControlError):
        operator.lend_lease(3, lambda: pytest.fail("it was started"))


def test_a_view_only_console_never_takes_control():
    viewer = Operator("tcp/127.0.0.1:1", load_arm("xmate3pro"), ArmKeys(), view_only=True)
    with pytest.raises(NoControlError, match="--view-only"):
        viewer.take_control(1)


def test_a_console_with_the_monitors_certificate_refuses_to_stop_even_beside_the_hosts(tmp_path):
    make_certificates(tmp_path)
    endpoint = "tls/127.0.0.1:1"
    viewer = Operator(endpoint, load_arm("xmate3pro"), ArmKeys(), tmp_path, view_only=True)
    with pytest.raises(
        NoControlError, match=r"nothing was stopped: .* monitor's certificate, .* 's2r stop --tls"
    ):
        viewer.stop()
    assert not viewer.can_stop
    assert Operator(endpoint, load_arm("xmate3pro"), ArmKeys(), tmp_path).can_stop
    assert Operator(endpoint, load_arm("xmate3pro"), ArmKeys(), view_only=True).can_stop


def test_a_stop_over_a_link_that_is_just_being_closed_goes_over_a_new_one(operator, monkeypatch):
    """As when the executor falls silent in the moment of the click: what Zenoh raises then is no error of ours."""

    class Closed:
        def stop(self):
            raise zenoh.ZError("session closed")

    operator._link = Closed()
    sent = SimpleNamespace(epoch=8), SimpleNamespace()
    monkeypatch.setattr("s2r_host.console.operator.send_stop", lambda *_: sent)
    assert operator.stop() == "stop accepted (epoch 8)"


PLACES = {"--out": "new", "--executor": "tcp/e:1", "--camera": "tcp/c:1", "--cell": "hall", "--tls": "keys"}


def test_a_run_is_repeated_with_its_own_options_in_this_consoles_cell():
    places = ("--executor", "tcp/a:1", "--out=x", "--cell", "lab", "--tls=old")
    line = ("run", "drawer", "--target", "0.15", *places, "--seed", "1")
    words = again(line, PLACES)
    assert words[:6] == ["run", "drawer", "--target", "0.15", "--seed", "1"]
    assert words[6:] == [word for pair in PLACES.items() for word in pair]
    assert "--tls" not in again(line, PLACES | {"--tls": None})
    with pytest.raises(RefusedError):
        again(("demo",), PLACES)


@pytest.mark.parametrize("asks", [("--target", "ask"), ("--target=ask",)])
def test_a_run_that_asked_for_its_target_is_repeated_with_the_one_it_was_told(asks):
    """Nobody answers a job: it would push the object and wait, without end."""
    line = ("run", "drawer", *asks, "--then", "50mm")
    words = again(line, {"--out": "new"}, told=-0.15)
    assert "=".join(words[2:-4]) == "--target=-0.15"
    assert words[-4:] == ["--then", "50mm", "--out", "new"]
    with pytest.raises(RefusedError, match=r"\(--target ask\) and was told none"):
        again(line, {"--out": "new"})


@pytest.mark.parametrize(
    ("kept", "told"),
    [
        ({"target_told": 0.15}, 0.15),
        ({"target_told": None}, None),
        ({"s_origin": 0.05}, pytest.approx(0.05)),  # of an older release
        (
            {"inputs": {"settings": {"seed": 0, "then": [0.1]}, "arguments": []}},
            None,
        ),  # s_target is the last one
    ],
)
def test_what_a_run_was_told_is_known_from_its_file(tmp_path, kept, told):
    (tmp_path / "first").mkdir()
    (tmp_path / "first/run.json").write_text(json.dumps(RUN | kept))
    index = RunIndex(tmp_path)
    index.refresh()
    (entry,) = index.find()
    index.close()
    assert entry.told == told


def jobs_are(monkeypatch, command, script):
    """What a job of the console runs instead of ``s2r``."""
    command.write_text(script)
    command.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(command))


def test_a_job_that_reads_what_is_typed_finds_nothing(tmp_path, monkeypatch):
    """Started from a terminal, it would share that with the console and wait for a line."""
    jobs_are(monkeypatch, tmp_path / "reads", '#!/bin/sh\nread line; echo "read: $line."\n')
    ended, jobs = threading.Event(), Jobs()
    read, write = os.pipe()
    own = os.dup(0)
    os.dup2(read, 0)
    try:
        jobs.start("a job", ["run"], lambda code: ended.set())
        assert ended.wait(10.0)
    finally:
        os.dup2(own, 0)
        for end in (own, read, write):
            os.close(end)
        jobs.close()
    assert jobs.lines[1:] == ["read: .", "exit 0"]


def test_a_job_tells_of_itself_whether_it_is_under_way(tmp_path, monkeypatch):
    """Also while another one runs after it."""
    jobs_are(monkeypatch, tmp_path / "waits", "#!/bin/sh\ntest $3 = first || sleep 60\n")
    ended, jobs = threading.Event(), Jobs()
    first = jobs.start("a job", ["first"], lambda code: ended.set())
    assert ended.wait(10.0)
    second = jobs.start("a job", ["second"])
    assert (first(), second()) == (False, True)
    jobs.close()
    assert not second()


def test_an_unreadable_run_is_left_out_and_a_removed_one_forgotten(tmp_path):
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad/run.json").write_text("{}")
    index = RunIndex(tmp_path)
    index.refresh()
    assert index.find() == []
    index.close()


def test_a_lid_is_listed_in_degrees_also_where_an_older_index_lies(tmp_path):
    older = sqlite3.connect(tmp_path / "index.sqlite")
    older.execute("CREATE TABLE runs (folder TEXT PRIMARY KEY, mtime REAL)")
    older.close()
    (tmp_path / "lid").mkdir()
    lid = RUN | {"task": "laptop", "unit": "rad", "s_target": -0.5}
    (tmp_path / "lid/run.json").write_text(json.dumps(lid))
    index = RunIndex(tmp_path)
    index.refresh()
    (entry,) = index.find()
    index.close()
    assert joint_value(entry.target, entry.unit) == "-28.6°"
    assert joint_value(entry.delta, entry.unit) == "–"
    assert joint_value(0.15, "m") == "+150.0 mm"


@pytest.mark.parametrize(
    ("folder", "other"),
    [
        ("old", {"delta": [0.1]}),
        ("old", {"delta": "0.1 mm"}),
        ("old", {"exit": {"code": 0, "name": "OK", "reason": "\ud800"}}),
        ("old", {"inputs": {"settings": {"seed": 1 << 70}, "arguments": []}}),
        ("old", {"inputs": {"settings": {"seed": 0}, "arguments": None}}),
        ("old", {"verdicts": 3}),
        (os.fsdecode(b"sch\xfcblade"), {}),  # of a disk that was written in another encoding
    ],
)
def test_one_run_that_cannot_be_listed_hides_no_other(tmp_path, caplog, folder, other):
    for name, run in (("first", RUN), (folder, RUN | other)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text(json.dumps(run))
    index = RunIndex(tmp_path)
    for _ in range(2):
        index.refresh()
        assert [entry.name for entry in index.find()] == ["first"]
    index.close()
    assert len(caplog.records) == 1
    assert "run.json is left out of the index" in caplog.text


def test_runs_that_are_called_alike_are_told_apart(tmp_path):
    for name in ("monday/drawer", "tuesday/drawer", "drawer"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "run.json").write_text(json.dumps(RUN))
    index = RunIndex(tmp_path)
    index.refresh()
    assert {entry.name: entry.folder for entry in index.find()} == {
        name: tmp_path / name for name in ("monday/drawer", "tuesday/drawer", "drawer")
    }
    index.close()


def no_file(place: Path) -> None:
    place.mkdir()


def damaged(place: Path) -> None:
    place.write_bytes(b"no database" * 100)


def read_only(place: Path) -> None:
    """As one on a disk that is mounted for reading: it opens, and takes nothing."""
    RunIndex(place.parent).close()
    place.chmod(0o444)


@pytest.mark.parametrize("spoil", [no_file, damaged, read_only])
def test_runs_are_shown_where_their_index_cannot_be_kept(tmp_path, monkeypatch, caplog, spoil):
    (tmp_path / "first").mkdir()
    (tmp_path / "first/run.json").write_text(json.dumps(RUN))
    spoil(tmp_path / "index.sqlite")
    connect = sqlite3.connect
    if spoil is read_only:  # root may write where the file's mode forbids it
        monkeypatch.setattr(
            sqlite3,
            "connect",
            lambda place, **how: connect(
                f"file:{place}{'' if place == ':memory:' else '?mode=ro'}", uri=True, **how
            ),
        )
    index = RunIndex(tmp_path)
    index.refresh()
    assert [entry.name for entry in index.find()] == ["first"]
    index.close()
    assert "index.sqlite cannot be kept" in caplog.text


STATE = {"missed": 0, "crc_errors": 0, "tx_failed": 0, "overruns": 0, "realtime": True}
TIMING = {"records_dropped": 0, "recording_lost_ticks": 0, "recording_problem": ""}


@pytest.mark.parametrize(
    ("state", "timing", "says"),
    [
        ({}, {}, "Nobody"),
        ({"missed": 3}, {}, "Drives or bus: 3"),
        ({"crc_errors": 2}, {}, "wiring"),
        ({"overruns": 1}, {}, "This machine"),
        ({}, {"recording_lost_ticks": 9, "recording_problem": "No space left"}, "No space left"),
    ],
)
def test_blame_names_the_guilty_part(state, timing, says):
    found = blame(STATE | state, TIMING | timing, Health(100.0, 0.01))
    assert says in found[0][0]


def test_a_silent_executor_is_blamed_first():
    assert "silent" in blame(STATE, TIMING, Health(0.0, 3.0))[0][0]


def test_a_run_that_has_ended_is_seen_to_have_ended_although_its_recording_grew_no_more(tmp_path):
    (tmp_path / "first").mkdir()
    with RunRecorder(tmp_path / "first/run.mcap", "/lab/a", ("a",)) as recorder:
        recorder.add_stage("view A", "begun")
    watch = RunWatch(tmp_path)
    assert not watch.look().ended
    (tmp_path / "first/run.json").write_text("{}")
    assert watch.look().ended
    ended = {"code": 6, "name": "PROTECTION", "reason": "<b>"}
    (tmp_path / "first/run.json").write_text(json.dumps(RUN | {"exit": ended}))
    sight = watch.look()
    assert sight.outcome == "exit 6 protection: <b>"
    assert "exit 6 protection: &lt;b&gt;" in _stages(sight)


def test_a_run_that_asks_for_its_target_has_not_ended(tmp_path):
    """It has written what it believes by then, for whoever is asked."""
    (tmp_path / "first").mkdir()
    with RunRecorder(tmp_path / "first/run.mcap", "/lab/a", ("a",)) as recorder:
        recorder.add_stage("build model", "ended")
    asking = RUN | {
        "ended": False, "s_target": None, "exit": {"code": 1, "name": "BUG", "reason": "the run did not end"}
    }  # fmt: skip
    (tmp_path / "first/run.json").write_text(json.dumps(asking))
    sight = RunWatch(tmp_path).look()
    assert (sight.ended, sight.outcome) == (False, "")
    assert "Run first, under way" in _stages(sight)
    index = RunIndex(tmp_path)
    index.refresh()
    (entry,) = index.find()
    assert (entry.exit, entry.code) == ("not ended", None)
    assert index.find("bug") == []
    (tmp_path / "first/run.json").write_text(json.dumps(RUN | {"ended": True}))
    os.utime(tmp_path / "first/run.json", (1, 1))
    assert RunWatch(tmp_path).look().outcome == "exit 0 ok: "
    index.refresh()
    (entry,) = index.find()
    assert (entry.exit, entry.code) == ("exit 0 ok", 0)
    index.close()


def test_nothing_of_an_executor_that_was_started_again_is_told_as_the_new_ones():
    """It has had no plan, and its clock begins anew."""
    now = [100.0]
    feed = Feed(SimpleNamespace(declare_subscriber=lambda *_: None), "/lab/a", lambda: now[0])  # pyright: ignore[reportArgumentType]
    joints = {"name": ["a"], "position": [0.0], "velocity": [0.0], "effort": [0.0]}
    points = [{"positions": [0.0]}, {"positions": [1.0], "time_from_start": {"sec": 2}}]
    feed.keep("plan", pack(TRAJECTORY, {"header": {"frame_id": "old"}, "points": points}))
    for plan_seq, pause_s, plan, kept in ((3, 0.0, "old", 1), (3, 0.1, "old", 2), (0, 3.0, None, 1)):
        now[0] += pause_s
        feed.keep("executor_state", pack(EXECUTOR_STATE, {"plan_seq": plan_seq}))
        feed.keep("joint_states", pack(JOINT_STATE, joints))
        found, recent = feed.plan(), feed.recent()
        assert (found.label if found else None) == plan
        assert recent is not None
        assert len(recent.t) == kept


def test_a_growing_run_is_seen_as_it_grows_and_what_was_read_is_not_read_again(tmp_path):
    """What was read is blanked out each time: whoever began anew would see nothing."""
    whole, under_way = tmp_path / "whole.mcap", tmp_path / "runs/first/run.mcap"
    under_way.parent.mkdir(parents=True)
    with RunRecorder(whole, "/lab/a", ("a",)) as recorder:
        for number in range(1, 5):
            recorder.add_stage(f"view {number}", "begun")
            depth_m = np.random.default_rng(number).uniform(0.5, 1.5, (120, 160)).astype(np.float32)
            frame = DepthFrame(depth_m, np.array([[150.0, 0, 80], [0, 150.0, 60], [0, 0, 1]]), np.eye(4))
            recorder.add_capture(f"view {number}", Capture("front", number, number, frame))
            recorder.add_stage(f"view {number}", "ended")
    data, watch, seen, read_to = whole.read_bytes(), RunWatch(tmp_path / "runs"), [], 0
    part = tmp_path / "part.mcap"
    for end in range(4000, len(data) + 4000, 4000):
        under_way.write_bytes(bytes(read_to) + data[read_to:end])
        sight = watch.look()
        seen.append((0, 0) if sight is None else (sight.views, len(sight.stages)))
        part.write_bytes(data[:end])
        scan = Scan(part)
        for _ in scan.records():
            pass
        read_to = scan.read_to
    assert seen == sorted(seen)
    assert len(set(seen)) > 3
    assert seen[-1] == (4, 4)
    expected = sight_of(whole)
    np.testing.assert_array_equal(sight.cloud, expected.cloud)
    assert sight.stages == expected.stages


def test_a_depth_image_becomes_points_in_the_base_frame():
    depth = np.zeros((4, 5))
    depth[1, 2] = 2.0
    K = np.array([[100.0, 0, 2], [0, 100.0, 1], [0, 0, 1]])
    X = np.eye(4)
    X[:3, 3] = (1.0, 0.0, 0.5)
    points, seen = cloud_of(depth, K, X)
    np.testing.assert_allclose(points, [[1.0, 0.0, 2.5]])
    assert seen.sum() == 1


ANSWER = {
    "verdict": "physics_missing",
    "where": [{"joint": "wrist", "share": 0.3, "regime": {"words": "at rest"}},
              {"joint": "elbow", "share": 0.7, "regime": {"words": "around position 0.338"}}],
    "effects": [
        {
            "name": "detent",
            "joint": "elbow",
            "probability": 0.97,
            "could_also_be": ["cogging"],
            "evidence": "removes 94% of the squared misfit in effort",
            "parameters": {
                "peak": {"value": 0.29976, "unit": "N·m", "interval90": [0.2933, 0.3062], "identifiable": True},
                "width": {"value": 1.0, "unit": "rad", "interval90": [0.0, 9.0], "identifiable": False},
            },
        }
    ],
    "parameters_off": [],
    "rejected": [{"name": f"effect {i}", "joint": "elbow", "why": "<no gain>"} for i in range(8)],
    "fit": {"unit": "rad", "holdout_before": 0.0014, "holdout_after": 0.0003, "effort_holdout_before": 0.0685,
            "effort_holdout_after": 0.0164},
    "next_experiment": {"separates": ["detent", "cogging"], "trajectory": "next_experiment.csv", "why": "chirp"},
    "notes": [],
}  # fmt: skip


def test_a_gap_answer_is_shown_with_units_intervals_and_what_was_rejected(tmp_path):
    (tmp_path / "gap.json").write_text(json.dumps(ANSWER))
    text = gap_markup(read_answer(tmp_path / "gap.json"), tmp_path)
    for words in (
        "physics is missing",
        "position [mrad]",
        ">1.4<",
        ">0.3<",
        ">21%<",
        "effort [N·m]",
        "detent on elbow, probability 0.97",
        "0.2998 N·m (0.2933 to 0.3062)",
        "not identifiable from this motion",
        "Could also be: cogging",
        "&lt;no gain&gt;",
        "effect 0, effect 1, effect 2",
        "Next experiment: detent or cogging?",
    ):
        assert words in text, words
    assert "<no gain>" not in text
    assert text.index("on elbow (70% of it)") < text.index("on wrist (30% of it)")


def test_places_and_units_of_an_answer_are_those_of_its_report(tmp_path):
    """What is left once most of the gap is told is not told on either; joints that turn and slide have both units."""
    shares = {"named first": 0.08, "a": 0.34, "b": 0.56, "c": 0.02}
    where = [{"joint": j, "share": s, "regime": {"words": f"words {j}"}} for j, s in shares.items()]
    fit = {"unit": "rad or m, per joint", "effort_holdout_before": 0.2, "effort_holdout_after": 0.1}
    text = gap_markup({"verdict": "physics_missing", "where": where, "effects": [], "fit": fit}, tmp_path)
    assert text.index("on b (56% of it), words b") < text.index("on a (34% of it), words a")
    assert "named first" not in text
    assert "effort [N·m or N, per joint]" in text


def test_numbers_that_are_off_are_told_with_their_place_and_without_a_unit_of_one(tmp_path):
    off = [
        {
            "name": "mass",
            "body": "hand",
            "from": 1.0,
            "to": 2.5,
            "unit": "kg",
            "could_also_be": ["effort_scale"],
        },
        {"name": "gear", "joint": "elbow", "from": 1.0, "to": 1.25, "unit": "1"},
    ]
    answer = {"verdict": "parameter_off", "where": [], "effects": [], "parameters_off": off}
    text = gap_markup(answer, tmp_path)
    assert ">mass of hand (could also be: effort_scale)<" in text
    assert ">2.5 kg<" in text
    assert ">gear of elbow<" in text
    assert ">1.25<" in text


def test_data_that_cannot_tell_are_told_with_the_reason_and_without_a_place(tmp_path):
    place = {"joint": "elbow", "share": 1.0, "regime": {"words": "throughout the motion"}}
    answer = {
        "verdict": "insufficient",
        "where": [place],
        "effects": [],
        "notes": ["cannot tell: it rests", "b"],
    }
    text = gap_markup(answer, tmp_path)
    assert text.count("cannot tell: it rests") == 1
    assert "throughout the motion" not in text


def test_a_file_that_is_no_gap_answer_is_refused(tmp_path):
    (tmp_path / "gap.json").write_text("[]")
    with pytest.raises(RecordingError, match="is no answer of 's2r gap'"):
        read_answer(tmp_path / "gap.json")
