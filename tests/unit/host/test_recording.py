"""What a run writes can be read again, by us and by others' tools."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from s2r_host.errors import RecordingError
from s2r_host.link_camera import Capture
from s2r_host.recording import JOINT_STATE, RunRecorder, joint_track, read_notes, read_plans, stamp

NAMES = tuple(f"joint{i}" for i in range(1, 8))


@dataclasses.dataclass(frozen=True)
class TimedPath:
    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


@dataclasses.dataclass(frozen=True)
class Frame:
    depth_m: np.ndarray
    K: np.ndarray
    X_base_camera: np.ndarray
    colour: np.ndarray | None


@pytest.fixture
def path():
    rng = np.random.default_rng(3)
    t = np.array([0.0, 0.5, 1.25])
    return TimedPath(t, *rng.normal(size=(3, 3, 7)))


@pytest.fixture
def capture():
    rng = np.random.default_rng(4)
    depth = rng.uniform(0.4, 1.2, (6, 8)).astype(np.float32)
    colour = rng.integers(0, 255, (6, 8, 3), dtype=np.uint8)
    return Capture("front", 123, 0, Frame(depth, np.diag([9.0, 9.0, 1.0]), np.eye(4), colour))


def executor_recording(tmp_path, q):
    """A recording as the executor writes it: JointState on its own topic."""
    file = tmp_path / "executor.mcap"
    recorder = RunRecorder(file, "/lab/xmate3pro", NAMES)
    for i, row in enumerate(q):
        body = {
            "header": {"stamp": stamp(5_000_000_000 + i * 1_000_000)},
            "name": NAMES,
            "position": row,
            "velocity": row,
        }
        recorder._put("joint_states", JOINT_STATE, body, 5_000_000_000 + i * 1_000_000)
    recorder.close()
    return file.read_bytes()


def test_plans_come_back_as_they_were_sent(tmp_path, path):
    with RunRecorder(tmp_path / "run.mcap", "/lab/xmate3pro", NAMES) as recorder:
        recorder.add_plan(path, "push 1", 11)
        recorder.add_plan(path, "home", 12)
    first, second = read_plans(tmp_path / "run.mcap")
    assert (first.number, first.seq, first.label) == (1, 11, "push 1")
    assert second.label == "home"
    assert np.allclose(first.t, path.t, atol=1e-9)
    assert np.array_equal(first.q, path.q)
    assert np.array_equal(first.ddq, path.ddq)


def test_executor_recording_is_merged_without_change(tmp_path):
    q = np.random.default_rng(0).normal(size=(50, 7))
    with RunRecorder(tmp_path / "run.mcap", "/lab/xmate3pro", NAMES) as recorder:
        assert recorder.add_recording(executor_recording(tmp_path, q)) == 50
    track = joint_track(tmp_path / "run.mcap")
    assert np.array_equal(track.q, q)
    assert track.t[-1] == pytest.approx(0.049)


@pytest.mark.parametrize("left", [0, 8, 0.6, 0.99])
def test_an_executor_recording_that_is_cut_off_is_refused_by_name(tmp_path, left):
    whole = executor_recording(tmp_path, np.random.default_rng(0).normal(size=(50, 7)))
    cut = whole[: left if isinstance(left, int) else int(left * len(whole))]
    with (
        RunRecorder(tmp_path / "run.mcap", "/lab/xmate3pro", NAMES) as recorder,
        pytest.raises(RecordingError, match=rf"the executor's recording \({len(cut)} bytes\) cannot be read"),
    ):
        recorder.add_recording(cut)


def test_notes_keep_their_order_and_values(tmp_path):
    with RunRecorder(tmp_path / "run.mcap", "/lab/xmate3pro", NAMES) as recorder:
        recorder.add_note("estimate", {"delta": -0.0451})
        recorder.add_note("state", {"s_m": 0.149})
    assert [n["kind"] for n in read_notes(tmp_path / "run.mcap")] == ["estimate", "state"]


def test_a_note_tells_the_time_of_the_arm_where_it_is_known(tmp_path, path, capture):
    stamps = iter([5, None, 7])
    with RunRecorder(tmp_path / "run.mcap", "/lab/a", NAMES, arm_stamp_ns=lambda: next(stamps)) as recorder:
        recorder.add_capture("A", capture)
        recorder.add_stage("push", "begun")
        recorder.add_plan(path, "push 1", 1)
    assert [note.get("arm_stamp_ns") for note in read_notes(tmp_path / "run.mcap")] == [5, None, 7]


def test_a_note_with_a_number_that_json_cannot_say_is_refused(tmp_path):
    with RunRecorder(tmp_path / "run.mcap", "/lab/arm", ("j1",)) as recorder:
        with pytest.raises(ValueError, match="not JSON compliant"):
            recorder.add_note("state", {"sigma": float("inf")})
        recorder.add_note("state", {"sigma": None})
    assert [note["sigma"] for note in read_notes(tmp_path / "run.mcap")] == [None]


def test_depth_image_decodes_in_a_ros_reader(tmp_path, capture):
    with RunRecorder(tmp_path / "run.mcap", "/lab/xmate3pro", NAMES) as recorder:
        recorder.add_capture("A", capture)
    with (tmp_path / "run.mcap").open("rb") as stream:
        decoded = {
            c.topic: m
            for _, c, _, m in make_reader(
                stream, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        }
    image = decoded["/lab/xmate3pro/camera/front/depth/image_raw"]
    depth = np.frombuffer(bytes(image.data), "<f4").reshape(image.height, image.width)
    assert np.array_equal(depth, capture.frame.depth_m)
    assert decoded["/lab/xmate3pro/camera/front/depth/camera_info"].k[0] == 9.0
    assert decoded["/lab/xmate3pro/camera/front/color/image_raw"].encoding == "rgb8"


def test_rosbags_opens_the_file_unmodified(tmp_path, capture, path):
    from rosbags.highlevel import AnyReader

    with RunRecorder(tmp_path / "run.mcap", "/lab/xmate3pro", NAMES) as recorder:
        recorder.add_capture("A", capture)
        recorder.add_plan(path, "push 1", 1)
    with AnyReader([tmp_path / "run.mcap"]) as reader:
        seen = {
            connection.topic: reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
        }
    assert seen["/lab/xmate3pro/plan"].joint_names == list(NAMES)
    assert seen["/lab/xmate3pro/camera/front/depth/image_raw"].encoding == "32FC1"


def test_rerun_opens_the_file_unmodified(tmp_path, capture, path):
    rerun = Path(sys.executable).with_name("rerun")
    file, converted = tmp_path / "run.mcap", tmp_path / "run.rrd"
    with RunRecorder(file, "/lab/xmate3pro", NAMES) as recorder:
        recorder.add_capture("A", capture)
        recorder.add_plan(path, "push 1", 1)
        recorder.add_recording(executor_recording(tmp_path, np.zeros((5, 7))))
    quiet = {**os.environ, "RERUN_ANALYTICS": "0", "NO_COLOR": "1"}
    for arguments in (["check", file], ["convert", file, "-o", converted]):
        done = subprocess.run(
            [rerun, "mcap", *arguments], env=quiet, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert converted.stat().st_size > 1000


def test_broken_recording_is_refused_by_name(tmp_path):
    (tmp_path / "run.mcap").write_bytes(b"not an mcap file at all, but long enough to try")
    with pytest.raises(RecordingError, match=r"run\.mcap is damaged"):
        read_plans(tmp_path / "run.mcap")


def test_missing_recording_is_refused_by_name(tmp_path):
    with pytest.raises(RecordingError, match=r"nowhere\.mcap: No such file"):
        read_plans(tmp_path / "nowhere.mcap")


def test_recording_without_plans_says_so(tmp_path):
    with RunRecorder(tmp_path / "run.mcap", "/lab/xmate3pro", NAMES):
        pass
    with pytest.raises(RecordingError, match="holds no plan"):
        read_plans(tmp_path / "run.mcap")
