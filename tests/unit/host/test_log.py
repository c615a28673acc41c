"""Recordings as files: damaged ones are told and mended, whole ones exported and compared."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, IndexType, Writer

from s2r_executor.observations import Encoder, Timeline
from s2r_executor.recorder_files import FileSettings, RecordingFiles
from s2r_executor.recorder_wire import Batch, PlanIdentity
from s2r_host.errors import RecordingError
from s2r_host.link_camera import Capture
from s2r_host.log.check import _rate_hz, check
from s2r_host.log.diff import diff
from s2r_host.log.export_lerobot import export_lerobot
from s2r_host.log.export_rrd import export_rrd
from s2r_host.log.export_tables import export_tables, parquet_joints
from s2r_host.log.recover import recover
from s2r_host.log.scan import Scan
from s2r_host.log.segments import segments
from s2r_host.log.tables import EXECUTOR_STATE, TRAJECTORY, read_recording
from s2r_host.log.view import write_html
from s2r_host.perception.frames import DepthFrame
from s2r_host.recording import JOINT_STATE, RunRecorder, stamp
from s2r_host.report.arm_shapes import ArmShapes
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.root import main
from s2r_protocol.exits import ExitCode, UsageError
from s2r_protocol.faults import ExecutorState
from s2r_protocol.ros2 import pack

ARM = load_arm("xmate3pro")
OFFSET_NS = 1_700_000_000_000_000_000
RECORD = np.dtype(
    [("tick", "<u8"), ("stamp_ns", "<i8"), ("state", "<u4"), ("cause", "<u4"), ("plan_id", "<u8")]
    + [("plan_t", "<f8"), ("speed_scale", "<f8")]
    + [(name, "<f8", (7,)) for name in ("q_ref", "dq_ref", "q_meas", "dq_meas", "tau_meas")]
)
EVENT = np.dtype([("tick", "<u8"), ("stamp_ns", "<i8"), ("kind", "<u4"), ("state", "<u4")])


def record(folder: Path, ticks=1500, offset_rad=0.0, chunk_bytes=32_768) -> Path:
    """A plan of ``ticks`` milliseconds and its tail, as the executor writes it."""
    done = []
    files = RecordingFiles(
        folder,
        ARM,
        "/lab/xmate3pro",
        Encoder(ARM, Timeline(OFFSET_NS, 1_000_000, stepped=True)),
        FileSettings(chunk_bytes, 0.01),
        {"arm": "xmate3pro", "model_hash": ARM.model_hash.hex()},
        lambda identity, path: done.append(path),
    )
    files.open_plan(PlanIdentity(1, 7, 2, "host:1", "push"), b"wire")
    rows = np.zeros(ticks + 300, RECORD)
    rows["tick"] = np.arange(len(rows))
    rows["state"] = np.where(rows["tick"] < ticks, ExecutorState.RUN, ExecutorState.HOLD)
    rows["plan_id"] = 1
    rows["plan_t"] = rows["tick"] * 1e-3
    wave = 0.3 * np.sin(rows["tick"] * 2e-3)[:, None] * np.ones(7)
    noise = 1e-6 * np.random.default_rng(3).standard_normal(wave.shape)  # so that chunks are not all alike
    rows["q_ref"], rows["q_meas"] = wave, wave + offset_rad + noise
    for begin in range(0, len(rows), 100):
        files.write(Batch(rows[begin : begin + 100], np.zeros(0, EVENT), "host:1"))
    files.finish()
    return done[0]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return record(tmp_path_factory.mktemp("whole"))


def command(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "s2r_protocol", *map(str, arguments)], capture_output=True, text=True
    )


def exit_code(*arguments: str | Path) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return int(ended.value.code or 0)


def test_a_whole_recording_is_whole(whole):
    found = check(whole)
    assert found.problems == []
    assert {t.name.rsplit("/", 1)[1]: t.messages for t in found.topics}["joint_states"] == 1700
    assert found.metadata["s2r"]["model_hash"] == ARM.model_hash.hex()
    assert "plan.s2r" in found.attachments


def test_only_what_comes_steadily_has_a_rate():
    steady = np.full(50, 0.01)
    steady[20] = 12.0  # between two motions
    assert _rate_hz(steady) == pytest.approx(100.0)
    bursts = np.tile([0.0, 0.0, 0.03, 1.5], 10)
    assert _rate_hz(bursts) is None
    assert _rate_hz(np.full(2, 10.0)) is None
    assert _rate_hz(np.zeros(0)) is None


def test_a_cut_recording_is_refused_and_mended_up_to_the_cut(whole, tmp_path):
    data = whole.read_bytes()
    for share in (0.35, 0.6, 0.9):
        cut, mended = tmp_path / f"cut{share}.mcap", tmp_path / f"mended{share}.mcap"
        cut.write_bytes(data[: int(share * len(data))])
        assert any("cut off" in text and "s2r log recover" in text for text in check(cut).problems)
        saved = recover(cut, mended)
        assert saved.damage.truncated
        assert check(mended).problems == []
        rows = read_recording(mended).joints()
        original = read_recording(whole).joints()
        np.testing.assert_array_equal(rows.q, original.q[: len(rows.q)])
    assert len(rows.q) > 1000


def test_a_recording_that_grows_while_it_is_read_has_no_bytes_less_than_none(whole, tmp_path):
    data, growing = whole.read_bytes(), tmp_path / "growing.mcap"
    growing.write_bytes(data[: len(data) // 3])
    scan = Scan(growing)
    records = scan.records()
    next(records)
    growing.write_bytes(data[: 2 * len(data) // 3])
    for _ in records:
        pass
    assert scan.damage.truncated
    assert 0 <= scan.damage.unread_bytes < 100_000


def test_a_recording_cut_off_in_its_first_record_is_called_cut_off(whole, tmp_path):
    stump = tmp_path / "stump.mcap"
    stump.write_bytes(whole.read_bytes()[:20])
    with pytest.raises(RecordingError, match=r"holds nothing readable: it is cut off .* after 20 bytes"):
        check(stump)


@pytest.mark.parametrize("target", ["folder", "nowhere/page.html"])
def test_a_result_that_cannot_be_written_is_refused_before_the_work(whole, tmp_path, target):
    (tmp_path / "folder").mkdir()
    for write in (write_html, export_rrd):
        with pytest.raises(UsageError, match=r"is a folder; name a file|there is no folder .*nowhere"):
            write(read_recording(whole), tmp_path / target)


@pytest.mark.parametrize(("kind", "inside"), [("csv", "own.csv"), ("parquet", "own.csv"), ("rrd", None)])
def test_an_export_replaces_nothing_at_the_place_that_is_named(whole, tmp_path, capsys, kind, inside):
    out = tmp_path / "out"
    if inside is None:
        out.write_text("mine")
    else:
        out.mkdir()
        (out / inside).write_text("mine")
    assert exit_code("log", "export", whole, "--to", kind, "--out", out) == ExitCode.USAGE
    assert re.search("name a new folder|name another file", capsys.readouterr().err)
    assert (out if inside is None else out / inside).read_text() == "mine"


def test_what_an_export_has_written_can_be_read_by_a_machine(whole, tmp_path, capsys):
    assert exit_code("log", "export", whole, "--to", "csv", "--out", tmp_path / "c", "--json") == 0
    written = json.loads(capsys.readouterr().out)
    assert written["format"] == "csv"
    assert not written["damaged"]
    assert all(Path(file).is_file() for file in written["files"])
    assert exit_code("log", "export", whole, "--to", "lerobot", "--out", tmp_path / "l", "--json") == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 1


def test_tables_beside_a_recording_may_be_made_again_and_a_dataset_not(whole, capsys):
    assert exit_code("log", "export", whole, "--to", "csv") == 0
    assert exit_code("log", "export", whole, "--to", "csv") == 0
    folder = whole.with_name(f"{whole.stem}-lerobot")
    folder.mkdir()
    (folder / "mine").touch()
    assert exit_code("log", "export", whole, "--to", "lerobot") == ExitCode.USAGE
    assert "not empty" in capsys.readouterr().err


@pytest.mark.parametrize("named", [False, True])
def test_a_page_replaces_an_earlier_page_and_nothing_else(whole, capsys, monkeypatch, named):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    page = whole.with_suffix(".html")
    words = ["view", whole, *(["--html", page] if named else [])]
    page.write_text("<p>mine</p>")
    assert exit_code(*words) == ExitCode.USAGE
    assert "exists and would be replaced" in capsys.readouterr().err
    assert page.read_text() == "<p>mine</p>"
    page.unlink()
    assert exit_code(*words) == 0
    assert exit_code(*words) == 0
    assert page.stat().st_size > 10_000


def test_a_page_is_refused_before_the_work_where_this_user_may_not_write(
    whole, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path)
    monkeypatch.setattr("s2r_host.log.tables.read_recording", None)
    assert exit_code("view", whole, "--html", tmp_path / "page.html") == ExitCode.USAGE
    assert f"{tmp_path} takes no file of this user, page.html neither" in capsys.readouterr().err


def test_a_page_that_finds_no_room_leaves_none_cut_off(whole, tmp_path):
    """A limit on the size of files does what a full disk does, without one."""
    page = tmp_path / "page.html"
    limited = ["sh", "-c", 'ulimit -f 40; exec "$@"', "sh", sys.executable, "-m", "s2r_protocol", "view"]
    ended = subprocess.run([*limited, whole, "--html", page], capture_output=True, text=True, check=False)
    assert ended.returncode == ExitCode.NOT_READY, ended.stderr
    assert "page.html: File too large" in ended.stderr
    assert list(tmp_path.iterdir()) == []


def overwritten(source: Path, target: Path, begin: int, count: int = 64) -> Path:
    """A copy with ``count`` bytes from ``begin`` on set to 0."""
    data = bytearray(source.read_bytes())
    data[begin : begin + count] = bytes(count)
    target.write_bytes(data)
    return target


def middle_of_chunk(recording: Path, number: int) -> int:
    with recording.open("rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[number]
    return chunk.chunk_start_offset + chunk.chunk_length // 2


def summary_start(recording: Path) -> int:
    *_, footer = StreamReader(str(recording)).records
    return footer.summary_start


def messages_in(recording: Path) -> int:
    return sum(topic.messages for topic in check(recording).topics)


@pytest.mark.parametrize("number", [0, 2])
def test_a_damaged_chunk_costs_only_itself(whole, tmp_path, number):
    """The first one, too, which holds the only schemas and channels but those of the summary."""
    with whole.open("rb") as stream:
        stream.seek(make_reader(stream).get_summary().chunk_indexes[number].chunk_start_offset)
        chunk = next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)
    lost = sum(isinstance(record, Message) for record in breakup_chunk(chunk))
    broken = overwritten(whole, tmp_path / "broken.mcap", middle_of_chunk(whole, number))
    assert any("damaged chunk" in text for text in check(broken).problems)
    saved = recover(broken, tmp_path / "mended.mcap")
    assert saved.damage.chunks == 1
    assert saved.orphans == 0
    assert saved.messages == messages_in(broken) == messages_in(whole) - lost
    assert 0 < lost < saved.messages / 5
    joints = read_recording(saved.path).joints()
    assert joints.stamp_ns[-1] == read_recording(whole).joints().stamp_ns[-1]
    assert list(read_recording(broken).topics) == list(read_recording(whole).topics)


@pytest.mark.parametrize("damage", ["cut off", "another checksum"])
def test_messages_whose_names_are_lost_are_not_saved_under_others(whole, tmp_path, capsys, damage):
    """Neither the first chunk nor the summary can be believed: it is told, and the attachments are all there is."""
    broken = overwritten(whole, tmp_path / "broken.mcap", middle_of_chunk(whole, 0))
    if damage == "cut off":
        broken.write_bytes(broken.read_bytes()[: summary_start(whole) - 1])
    else:
        overwritten(broken, broken, summary_start(whole) + 30, 1)
    assert exit_code("log", "recover", broken, "--out", tmp_path / "mended.mcap") == ExitCode.REFUSED
    told = capsys.readouterr()
    assert f"no message of {broken} could be saved" in told.err
    assert re.search(
        r"0 messages .* and \d attachments saved.*\n.*, [1-9]\d* messages without a channel", told.out
    )
    assert "plan.s2r" in read_recording(tmp_path / "mended.mcap").attachments


def test_a_recording_of_nameless_messages_is_not_called_unreadable(tmp_path):
    source = foreign(tmp_path / "bag.mcap", 200, chunk_size=1024, repeat_channels=False)
    broken = overwritten(source, tmp_path / "broken.mcap", middle_of_chunk(source, 0))
    with pytest.raises(RecordingError, match=r"the names of the topics of its \d+ messages are lost"):
        recover(broken, tmp_path / "mended.mcap")


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_damaged_chunk_is_told_however_it_is_compressed(tmp_path, compression):
    """As in recordings of others."""
    file, rng = tmp_path / "other.mcap", np.random.default_rng(5)
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=4096, compression=compression)
        writer.start(profile="ros2")
        channel = writer.register_channel("/x", "json", 0)
        for k in range(500):
            writer.add_message(channel, k, b'{"x": %d}' % k, k)
        writer.finish()
    data = file.read_bytes()
    messages, found = read_recording(file).topics["/x"].messages, 0
    for place in rng.integers(200, 3000, 40):
        broken = bytearray(data)
        broken[place] ^= 0x55
        file.write_bytes(broken)
        if check(file).problems:
            found += 1
        else:  # in an index, or another way to pack the same bytes
            assert read_recording(file).topics["/x"].messages == messages
    assert found > 10


def foreign(file: Path, messages: int, **options) -> Path:
    """A whole recording of somebody else: JSON without a schema, and joints as ROS 2 allows them, without an index."""
    joints = {"header": {"stamp": stamp(OFFSET_NS)}, "velocity": [], "effort": [np.nan]}
    with file.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2", library="libmcap 1.3.0")
        text = writer.register_channel("/chatter", "json", 0)
        schema = writer.register_schema(JOINT_STATE, "ros2msg", b"")
        states = writer.register_channel("/joint_states", "cdr", schema)
        for k in range(messages):
            writer.add_message(text, k, b'{"x": %d}' % k, k)
            names = ("a", "b")[: 1 + k % 2]
            body = {**joints, "name": names, "position": [0.1] * len(names)}
            writer.add_message(states, k, pack(JOINT_STATE, body), k)
        writer.finish()
    return file


BARE = {
    "use_statistics": False,
    "repeat_schemas": False,
    "repeat_channels": False,
    "use_summary_offsets": False,
}


@pytest.mark.parametrize("messages", [0, 20])
@pytest.mark.parametrize("options", [{}, {"index_types": IndexType.NONE, **BARE}], ids=["indexed", "bare"])
def test_a_whole_recording_of_somebody_else_is_whole(tmp_path, capsys, messages, options):
    file = foreign(tmp_path / "bag.mcap", messages, **options)
    found = check(file)
    assert found.problems == []
    assert any("no index" in text for text in found.notes) == bool(options)
    assert any("messages are 'json', not CDR" in text for text in found.notes) == bool(messages)
    assert exit_code("log", "check", file) == ExitCode.OK
    assert "whole" in capsys.readouterr().out
    if messages:
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
        assert any("cut off" in text for text in check(file).problems)


def test_a_message_that_does_not_decode_is_a_problem_in_any_recording(tmp_path):
    file = tmp_path / "bag.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="libmcap 1.3.0")
        channel = writer.register_channel(
            "/joint_states", "cdr", writer.register_schema(JOINT_STATE, "ros2msg", b"")
        )
        writer.add_message(channel, 1, bytes((0, 1, 0, 0)) + b"abc", 1)
        writer.finish()
    assert check(file).problems == ["/joint_states: 1 of 1 messages cannot be decoded"]


def test_what_is_no_recording_is_refused_by_name(tmp_path):
    text = tmp_path / "notes.mcap"
    text.write_text("these are notes, not a recording")
    with pytest.raises(RecordingError, match=r"notes\.mcap is no MCAP recording"):
        check(text)


def test_a_recovery_that_saves_nothing_is_refused_and_leaves_no_file(whole, tmp_path, capsys):
    stump, mended = tmp_path / "stump.mcap", tmp_path / "mended.mcap"
    stump.write_bytes(whole.read_bytes()[:60])  # its first record, and a piece of the next
    assert exit_code("log", "recover", stump, "--out", mended) == ExitCode.REFUSED
    said = capsys.readouterr().err
    assert (
        f"nothing of {stump} could be saved: no message and no attachment of its 60 bytes is readable" in said
    )
    assert "look for a copy" in said
    assert list(tmp_path.iterdir()) == [stump]


@pytest.mark.parametrize(("messages", "says"), [(0, "it has no messages"), (3, "it has /x, of which none")])
def test_what_holds_nothing_for_a_table_is_refused_and_leaves_no_folder(tmp_path, capsys, messages, says):
    other = tmp_path / "other.mcap"
    with other.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/x", "json", 0)
        for k in range(messages):
            writer.add_message(channel, k, b"{}", k)
        writer.finish()
    for kind in ("csv", "parquet"):
        assert exit_code("log", "export", other, "--to", kind) == ExitCode.REFUSED
        assert says in capsys.readouterr().err
    code = exit_code("log", "recover", other, "--out", tmp_path / "saved.mcap")
    assert code == (ExitCode.OK if messages else ExitCode.REFUSED)
    assert {path.suffix for path in tmp_path.iterdir()} == {".mcap"}


@pytest.mark.parametrize(("option", "kind"), [("--fps", "csv"), ("--fps", "rrd"), ("--arm", "lerobot")])
def test_an_option_of_another_format_is_refused(whole, tmp_path, capsys, option, kind):
    place = tmp_path / "new"
    code = exit_code("log", "export", whole, "--to", kind, option, "30", "--out", place)
    assert code == ExitCode.USAGE
    assert f"{option} is of --to " in capsys.readouterr().err
    assert not place.exists()


def test_recover_never_overwrites(whole, tmp_path):
    there = tmp_path / "there.mcap"
    there.write_bytes(b"")
    with pytest.raises(RecordingError, match="exists"):
        recover(whole, there)


def test_parquet_and_csv_hold_every_tick_with_units_in_the_names(whole, tmp_path):
    recording = read_recording(whole)
    written, left_out = export_tables(recording, tmp_path / "p", "parquet")
    assert left_out == []
    columns = parquet_joints(tmp_path / "p" / "joint_states.parquet")
    np.testing.assert_array_equal(columns["q_rad.joint3"], recording.joints().q[:, 2])
    export_tables(recording, tmp_path / "c", "csv")
    lines = (tmp_path / "c" / "joint_states.csv").read_text().splitlines()
    assert len(lines) == 1701
    assert '"tau_Nm.joint7"' in lines[0]
    assert len(written) == 3


def exported(recording: Path, folder: Path) -> dict[str, dict[str, list[str]]]:
    """The tables of an export to CSV: columns of texts by table and name."""
    assert exit_code("log", "export", recording, "--to", "csv", "--out", folder) == ExitCode.OK
    tables = {}
    for path in folder.glob("*.csv"):
        with path.open(newline="") as stream:
            head, *rows = csv.reader(stream)
        tables[path.stem] = {name: [row[i] for row in rows] for i, name in enumerate(head)}
    return tables


def test_a_plan_is_exported_knot_by_knot(tmp_path):
    t = np.linspace(0.0, 2.0, 100)
    paths = [
        SimpleNamespace(
            t=t, **{k: scale * np.sin(np.outer(t, [n, n + 1])) for n, k in enumerate(("q", "dq", "ddq"))}
        )
        for scale in (1.0, 0.5)
    ]
    with RunRecorder(tmp_path / "run.mcap", "/lab/a", ("pan", "lift")) as recorder:
        for path in paths:
            recorder.add_plan(path, "push", 1)
    plan = {
        name: np.array(values, float)
        for name, values in exported(tmp_path / "run.mcap", tmp_path / "t")["plan"].items()
    }
    assert plan["plan"].tolist() == [1] * 100 + [2] * 100
    np.testing.assert_allclose(plan["t_s"], np.tile(t, 2), atol=1e-9)
    for label, key in (("q_rad", "q"), ("dq_rad_s", "dq"), ("ddq_rad_s2", "ddq")):
        for i, joint in enumerate(("pan", "lift")):
            wanted = np.concatenate([getattr(path, key)[:, i] for path in paths])
            np.testing.assert_allclose(plan[f"{label}.{joint}"], wanted, atol=1e-12)
    assert not any(name.startswith("tau_Nm") for name in plan)


def trajectories(file: Path, *plans: tuple[tuple[str, ...], list[float], list[float]]) -> Path:
    """A recording of plans of one knot each: joints, positions, velocities."""
    with RunRecorder(file, "/lab/a", ()) as recorder:
        for names, q, dq in plans:
            point = {"positions": q, "velocities": dq, "time_from_start": stamp(0)}
            body = {"header": {"stamp": stamp(OFFSET_NS)}, "joint_names": names, "points": [point]}
            recorder._put("plan", TRAJECTORY, body, OFFSET_NS)
    return file


def test_plans_of_others_may_be_of_some_joints_and_without_speeds(tmp_path):
    file = trajectories(tmp_path / "two.mcap", (("a", "b"), [1.0, 2.0], []), (("b",), [3.0], [4.0]))
    plan = exported(file, tmp_path / "t")["plan"]
    assert plan["q_rad.a"] == ["1", "nan"]
    assert plan["q_rad.b"] == ["2", "3"]
    assert plan["dq_rad_s.b"] == ["nan", "4"]


def test_a_knot_that_is_not_of_the_plans_joints_is_refused(tmp_path, capsys):
    file = trajectories(tmp_path / "bad.mcap", (("a", "b"), [1.0], []))
    assert exit_code("log", "export", file, "--to", "csv") == ExitCode.REFUSED
    assert "/lab/a/plan: a knot has 1 positions for 2 joints" in capsys.readouterr().err


def test_a_recorded_state_has_no_columns_of_what_was_not_measured(whole, tmp_path):
    columns = exported(whole, tmp_path / "t")["executor_state"]
    assert {"tick", "state", "cause", "plan_seq", "plan_t", "epoch", "lease_holder", "speed_scale"} <= set(
        columns
    )
    assert not {"plan_done", "realtime", "overruns", "missed", "tx_failed", "crc_errors", "bus_load"} & set(
        columns
    )


def test_a_published_state_that_others_recorded_has_all_of_its_columns(tmp_path):
    state = {"header": {"stamp": stamp(OFFSET_NS)}, "plan_done": True, "drive_state": [4, 4], "missed": 3}
    with RunRecorder(tmp_path / "bag.mcap", "/lab/a", ("a", "b")) as recorder:
        recorder._put("executor_state", EXECUTOR_STATE, state, OFFSET_NS)
    columns = exported(tmp_path / "bag.mcap", tmp_path / "t")["executor_state"]
    assert (columns["plan_done"], columns["missed"], columns["drive_state[1]"]) == (["true"], ["3"], ["4"])


def test_an_array_too_long_for_columns_is_left_out_by_name(tmp_path, capsys):
    long = {"edge_s": np.arange(65.0), "count": np.arange(3), "recording_problem": ""}
    with RunRecorder(tmp_path / "run.mcap", "/lab/a", ("a",)) as recorder:
        for _ in range(2):
            recorder._put("timing", "s2r_msgs/msg/TickTiming", long, OFFSET_NS)
    columns = exported(tmp_path / "run.mcap", tmp_path / "t")["timing"]
    assert "count[2]" in columns
    assert not any(name.startswith("edge_s") for name in columns)
    assert "left out: /lab/a/timing: edge_s\n" in capsys.readouterr().err


SECOND_NS = 1_000_000_000


def seen_and_moved(
    file: Path, monkeypatch, host_s: tuple[float, float, float], arm_s: tuple = (None,) * 3
) -> Path:
    """View A, a motion at 1 to 2 s of the core's clock, view B; host's and arm's clock [s] at view, plan and view."""
    host_ns, arm_ns = iter(host_s), iter(arm_s)
    now = SimpleNamespace(host_s=0.0, arm_s=0.0)

    def go_on() -> None:
        now.host_s, now.arm_s = next(host_ns), next(arm_ns)

    def at(t_s: float | None) -> int | None:
        return None if t_s is None else OFFSET_NS + round(t_s * SECOND_NS)

    monkeypatch.setattr("s2r_host.recording.time", SimpleNamespace(time_ns=lambda: at(now.host_s)))
    frame = DepthFrame(np.full((20, 30), 0.5, np.float32), np.diag([9.0, 9.0, 1.0]), np.eye(4), None)
    t = np.array([0.0, 1.0])
    path = SimpleNamespace(t=t, **{key: np.zeros((2, 7)) for key in ("q", "dq", "ddq")})
    with RunRecorder(
        file, "/lab/xmate3pro", ARM.joint_names, ARM, arm_stamp_ns=lambda: at(now.arm_s)
    ) as recorder:
        go_on()
        recorder.add_capture("A", Capture("front", 1, 0, frame))
        go_on()
        recorder.add_plan(path, "push 1", 3)
        for t_s in np.linspace(1.0, 2.0, 11):
            head = {"header": {"stamp": stamp(at(t_s))}}
            recorder._put(
                "executor_state", EXECUTOR_STATE, {**head, "plan_seq": 3, "plan_t": t_s - 1}, at(t_s)
            )
            body = {**head, "name": ARM.joint_names, "position": np.zeros(7), "velocity": np.zeros(7)}
            recorder._put("joint_states", JOINT_STATE, body, at(t_s))
        go_on()
        recorder.add_capture("B", Capture("front", 2, 0, frame))
    return file


LOCK_STEP_S = (9.0, 9.5, 30.0)


@pytest.mark.parametrize(
    ("host_s", "arm_s", "placed_s"),
    [
        (LOCK_STEP_S, (0.9, 0.9, 2.3), (0.9, 0.9, 2.3)),
        (LOCK_STEP_S, (0.9, 0.9, None), (0.9, 0.9, 2.0)),
        (LOCK_STEP_S, (None, None, None), (1.0, 1.0, 2.0)),
        ((0.8, 0.95, 2.7), (None, None, None), (0.8, 0.95, 2.7)),
    ],
    ids=["told", "silent once", "older", "older, of one clock"],
)
def test_views_are_placed_before_and_behind_the_motion_between_them(
    tmp_path, monkeypatch, host_s, arm_s, placed_s
):
    file = seen_and_moved(tmp_path / "run.mcap", monkeypatch, host_s, arm_s)
    tables = exported(file, tmp_path / "t")

    def column(table: str) -> list[float]:
        return [round((int(text) - OFFSET_NS) / SECOND_NS, 3) for text in tables[table]["arm_time_ns"]]

    assert column("run") == list(placed_s)
    assert column("camera__front__depth__camera_info") == [placed_s[0], placed_s[2]]
    assert column("plan") == [placed_s[1]] * 2
    assert "arm_time_ns" not in tables["executor_state"]


def test_a_view_in_rerun_is_where_the_arm_was(tmp_path, monkeypatch):
    rerun = pytest.importorskip("rerun")
    times, stream = [], rerun.RecordingStream

    class Told(stream):
        def log(self, entity: str, *what: object, **options: object) -> None:
            if entity == "camera":
                times.append(self.at_ns)
            super().log(entity, *what, **options)

        def set_time(self, timeline: str, **at: np.datetime64) -> None:
            self.at_ns = at["timestamp"].astype(int)
            super().set_time(timeline, **at)

    monkeypatch.setattr(rerun, "RecordingStream", Told)
    file = seen_and_moved(tmp_path / "run.mcap", monkeypatch, LOCK_STEP_S, (0.9, 0.9, 2.3))
    export_rrd(read_recording(file), tmp_path / "run.rrd")
    assert [round((at - OFFSET_NS) / SECOND_NS, 3) for at in times] == [0.9, 2.3]


def two_arms(file: Path, of_right: float) -> Path:
    """A recording of two arms in one cell; ``of_right`` is a joint value of the second [rad]."""
    with RunRecorder(file, "/lab/left", ("a",)) as recorder:
        for side, q in (("left", 1.0), ("right", of_right)):
            recorder._namespace = f"/lab/{side}"
            body = {"header": {"stamp": stamp(OFFSET_NS)}, "name": ("a",), "position": [q], "velocity": [0.0]}
            recorder._put("joint_states", JOINT_STATE, body, OFFSET_NS)
    return file


def test_tables_of_two_arms_do_not_replace_each_other(tmp_path):
    recording = read_recording(two_arms(tmp_path / "two.mcap", 2.0))
    written, _ = export_tables(recording, tmp_path / "tables", "parquet")
    assert [path.stem for path in written] == ["lab__left__joint_states", "lab__right__joint_states"]
    assert [float(parquet_joints(path)["q_rad.a"][0]) for path in written] == [1.0, 2.0]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_an_export_leaves_no_table_of_an_earlier_one(tmp_path, kind):
    """What a person put there stays."""
    source, folder = tmp_path / "run.mcap", tmp_path / f"run-{kind}"
    with RunRecorder(source, "/lab/left", ("a",)) as recorder:
        body = {"header": {"stamp": stamp(OFFSET_NS)}, "name": ("a",), "position": [0.1], "velocity": [0.0]}
        recorder._put("joint_states", JOINT_STATE, body, OFFSET_NS)
    assert exit_code("log", "export", source, "--to", kind) == ExitCode.OK
    own = folder / f"my_own.{kind}"
    own.write_text("mine")
    assert (folder / f"joint_states.{kind}").exists()
    two_arms(source, 2.0)
    assert exit_code("log", "export", source, "--to", kind) == ExitCode.OK
    tables = {path.stem for path in folder.glob(f"*.{kind}")}
    assert tables == {"lab__left__joint_states", "lab__right__joint_states", "my_own"}
    assert own.read_text() == "mine"


def test_numbers_of_every_arm_are_checked(tmp_path):
    problems = check(two_arms(tmp_path / "two.mcap", np.nan)).problems
    assert problems == ["/lab/right/joint_states: positions hold NaN or infinity"]


BACKWARDS = ("gripper", *reversed(ARM.joint_names))


def of_others(file: Path, names: tuple[str, ...] = BACKWARDS, begin_ns: int = OFFSET_NS) -> Path:
    """A recording of somebody else, whose joints come in another order."""
    with RunRecorder(file, "/lab/other", names) as recorder:
        for k in range(3):
            t_ns = begin_ns + k * 10_000_000
            q = [0.1 * (ARM.joint_names.index(name) if name in ARM.joint_names else 9) for name in names]
            body = {
                "header": {"stamp": stamp(t_ns)},
                "name": names,
                "position": q,
                "velocity": [0.0] * len(q),
            }
            recorder._put("joint_states", JOINT_STATE, body, t_ns)
    return file


@pytest.mark.parametrize("write", [write_html, export_rrd])
def test_an_arm_is_drawn_with_its_joints_in_its_own_order(tmp_path, monkeypatch, write):
    pytest.importorskip("rerun")
    drawn = []
    poses = ArmShapes.poses
    monkeypatch.setattr(ArmShapes, "poses", lambda shapes, q: (drawn.append(q), poses(shapes, q))[1])
    write(read_recording(of_others(tmp_path / "other.mcap")), tmp_path / "out", ARM.name)
    np.testing.assert_allclose(drawn[0], 0.1 * np.arange(7))


@pytest.mark.parametrize("write", [write_html, export_rrd])
def test_a_recording_of_other_joints_is_not_drawn_as_this_arm(tmp_path, write):
    pytest.importorskip("rerun")
    other = of_others(tmp_path / "other.mcap", ("a", "b"))
    with pytest.raises(RecordingError, match="is of joints a, b; xmate3pro has joint1"):
        write(read_recording(other), tmp_path / "out", ARM.name)


def test_the_lerobot_dataset_is_read_by_an_independent_reader(whole, tmp_path):
    assert export_lerobot(read_recording(whole), tmp_path / "set", fps=50) == 1
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert info["total_frames"] == 75 + 10  # 1.5 s and the 0.2 s tail
    assert info["features"]["observation.state"]["shape"] == [21]
    reader = pytest.importorskip("rerun.experimental").LeRobotReader
    assert reader(str(tmp_path / "set")) is not None


def test_an_export_to_rrd_that_cannot_be_written_is_the_users_file_and_no_bug(whole):
    pytest.importorskip("rerun")
    assert exit_code("log", "export", whole, "--to", "rrd", "--out", "/proc/x.rrd") == ExitCode.USAGE


@pytest.mark.parametrize("tolerance", ["nan", "inf"])
def test_a_tolerance_that_every_residual_would_pass_is_refused(whole, capsys, tolerance):
    assert exit_code("log", "diff", whole, whole, "--tolerance", tolerance) == ExitCode.USAGE
    assert f"'--tolerance': {tolerance} is not a finite number" in capsys.readouterr().err


def test_rerun_accepts_the_recording_and_its_export(whole, tmp_path):
    rerun = Path(sys.executable).with_name("rerun")
    if not rerun.exists():
        pytest.skip("rerun-sdk is not installed")
    checked = subprocess.run([rerun, "mcap", "check", whole], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert exit_code("log", "export", whole, "--to", "rrd", "--out", tmp_path / "x.rrd") == 0
    verified = subprocess.run([rerun, "rrd", "verify", tmp_path / "x.rrd"], capture_output=True, text=True)
    assert verified.returncode == 0, verified.stdout + verified.stderr
    printed = subprocess.run([rerun, "rrd", "print", tmp_path / "x.rrd"], capture_output=True, text=True)
    assert "/arm/measured/joint7" in printed.stdout + printed.stderr


def test_two_runs_are_two_recordings_in_rerun(tmp_path, monkeypatch):
    rerun = pytest.importorskip("rerun")
    named, stream = [], rerun.RecordingStream
    monkeypatch.setattr(
        rerun, "RecordingStream", lambda app, recording_id: (named.append(recording_id), stream(app))[1]
    )
    for name, delay_ns in (("first", 0), ("second", 10_000_000_000)):
        (tmp_path / name).mkdir()
        file = of_others(tmp_path / name / "run.mcap", begin_ns=OFFSET_NS + delay_ns)
        export_rrd(read_recording(file), tmp_path / name / "run.rrd", ARM.name)
    assert len(set(named)) == 2


def test_motions_are_found_by_the_executors_own_states(whole):
    (only,) = segments(read_recording(whole))
    assert (only.seq, only.label) == (7, "push")


def test_a_shifted_recording_differs_by_the_shift(whole, tmp_path):
    shifted = record(tmp_path, offset_rad=2e-3)
    found = diff(read_recording(whole), read_recording(shifted))
    np.testing.assert_allclose(found.motions[0].rms_rad, 2e-3, rtol=1e-2)
    assert found.exceeds(1e-3)
    assert not found.exceeds(3e-3)


def test_a_recording_that_is_cut_off_is_not_the_same_as_the_whole(whole, tmp_path, capsys):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: int(0.6 * whole.stat().st_size)])
    for pair in ((whole, cut), (cut, whole)):
        assert exit_code("log", "diff", *pair) == ExitCode.DIFFERENCE
        told = capsys.readouterr()
        assert f"{cut} is damaged" in told.err
        assert str(whole) not in told.err
        durations = [float(text) for text in re.search(r"push: (\S+) s and (\S+) s,", told.out).groups()]
        assert sorted(durations) == [pytest.approx(1.0, abs=0.4), pytest.approx(1.7, abs=0.02)]
        assert "what is in one only is not compared" in told.out
        assert "they differ" in told.out
    assert exit_code("log", "diff", whole, cut, "--json") == ExitCode.DIFFERENCE
    found = json.loads(capsys.readouterr().out)
    assert found["damaged"] == [False, True]
    assert found["motions"][0]["reached_b_s"] < found["motions"][0]["reached_a_s"] - 0.1


def test_a_longer_rest_behind_the_same_motion_is_no_difference(tmp_path, capsys):
    """A plan that comes next ends the recording of the rest."""
    long, short = (tmp_path / name for name in ("long.mcap", "short.mcap"))
    for file, rest in ((long, 20), (short, 2)):
        with RunRecorder(file, "/lab/a", ("a",)) as recorder:
            for k in range(100 + rest):
                at_ns = OFFSET_NS + k * 10_000_000
                head = {"header": {"stamp": stamp(at_ns)}}
                state = {**head, "plan_seq": 1, "plan_t": 0.01 * min(k, 100), "state": ExecutorState.HOLD}
                recorder._put("executor_state", EXECUTOR_STATE, state, at_ns)
                body = {**head, "name": ("a",), "position": [0.01 * min(k, 100)], "velocity": [0.0]}
                recorder._put("joint_states", JOINT_STATE, body, at_ns)
    assert exit_code("log", "diff", long, short) == ExitCode.OK
    assert "1.19 s and 1.01 s" in capsys.readouterr().out


def test_diff_and_check_end_with_the_documented_codes(whole, tmp_path, capsys):
    shifted = record(tmp_path, offset_rad=2e-3)
    assert exit_code("log", "diff", whole, whole) == 0
    assert exit_code("log", "diff", whole, shifted, "--json") == 7
    assert json.loads(capsys.readouterr().out.split("\n", 2)[-1])["differs"] is True
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-2000])
    assert exit_code("log", "check", cut) == 4
    assert exit_code("log", "check", tmp_path) == 2


def test_a_folder_that_is_no_run_tells_what_it_holds_instead(tmp_path):
    from s2r_host.log.recording_file import recording_file

    demo, executor = tmp_path / "demo", tmp_path / "executor"
    (demo / "run").mkdir(parents=True)
    (demo / "run" / "run.mcap").touch()
    executor.mkdir()
    for age_s, name in ((20, "session-1.mcap"), (10, "plan-2-3.mcap")):
        (executor / name).touch()
        os.utime(executor / name, (1e9 - age_s, 1e9 - age_s))
    with pytest.raises(UsageError, match=r"its run is in .*demo/run: name that"):
        recording_file(demo)
    with pytest.raises(UsageError, match=r"2 recordings by other names, plan-2-3.mcap the newest"):
        recording_file(executor)
    with pytest.raises(UsageError, match=r"name a recording, or the folder"):
        recording_file(tmp_path)
