"""Every way a run can end, on real processes over the real wire: right exit code, one paragraph, readable files."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import zlib
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh

from s2r_host.cli_stop import send_stop
from s2r_host.link import ExecutorLink
from s2r_host.perception.synthetic import look_at
from s2r_host.recording import joint_track, read_notes, read_plans
from s2r_host.trajectory import TimeLawSettings, time_law
from s2r_protocol import codec
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import ExitCode
from s2r_protocol.faults import Cause, ExecutorState
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_sim.demo.processes import free_port, peer

TARGET_M = 0.15
WORLD_SEED = "1"


@pytest.fixture(scope="module")
def arm():
    return load_arm("xmate3pro")


@contextmanager
def running_plant(folder, packing="fd", pace="0"):
    """Stand-in and executor, as fast as they go; their endpoints, the truth log and a place for the run."""
    folder.mkdir(exist_ok=True)
    bus, truth = f"unix:{folder}/bus", folder / "truth.csv"
    camera, executor = f"tcp/127.0.0.1:{free_port()}", f"tcp/127.0.0.1:{free_port()}"
    sim = ["sim-arm", "--seed", WORLD_SEED, "--clock", "lockstep", "--pace", "0", "--bus", bus]
    sim += ["--listen", camera, "--truth", str(truth)]
    front = [
        "executor",
        "--bus",
        bus,
        "--packing",
        packing,
        "--clock",
        "lockstep",
        "--pace",
        pace,
        "--listen",
        executor,
    ]
    front += ["--record", str(folder / "executor")]
    with peer("sim-arm", sim, folder), peer("executor", front, folder):
        yield {"camera": camera, "executor": executor, "truth": truth, "out": folder / "run"}


@pytest.fixture
def plant(tmp_path):
    with running_plant(tmp_path) as plant:
        yield plant


@pytest.fixture
def paced_plant(tmp_path):
    """One whose motions take wall time, in which something can happen to them."""
    with running_plant(tmp_path, pace="2") as plant:
        yield plant


def command(*arguments):
    return [sys.executable, "-m", "s2r_protocol", *map(str, arguments)]


def run_arguments(plant, *more):
    return command(
        "run", "drawer", "--target", TARGET_M, "--executor", plant["executor"], "--camera", plant["camera"],
        "--out", plant["out"], *more,
    )  # fmt: skip


def run(plant, *more):
    return subprocess.run(run_arguments(plant, *more), capture_output=True, text=True, timeout=600)


def ending(plant):
    return json.loads((plant["out"] / "run.json").read_text())


def status(plant, arm):
    with ExecutorLink(plant["executor"], arm) as link:
        return link.status()


def wait_for_motion(plant, arm, label, timeout_s=600.0):
    """Until a plan with this label has run for a while."""
    deadline = time.monotonic() + timeout_s
    with ExecutorLink(plant["executor"], arm) as link:
        while time.monotonic() < deadline:
            now = link.status()
            if now.state == ExecutorState.RUN and now.plan_t > 0.3 and np.abs(now.dq_ref).max() > 0.02:
                return now
            time.sleep(0.01)
    raise AssertionError(f"no motion '{label}' within {timeout_s} s")


@pytest.mark.slow
def test_target_beyond_the_drawers_travel_is_refused_and_the_arm_rests(plant, arm):
    done = run(plant, "--target", "0.55")
    assert done.returncode == ExitCode.REFUSED, done.stderr
    assert "0.55" in ending(plant)["exit"]["reason"]
    now = status(plant, arm)
    assert now.state == ExecutorState.HOLD
    assert np.abs(now.dq_ref).max() == 0.0
    assert read_plans(plant["out"] / "run.mcap")[0].label == "push 1: approach"


@pytest.mark.slow
def test_a_target_at_which_the_push_left_the_drawer_needs_no_plan(plant):
    done = run(plant, "--from", "pushed", "--target", "1mm")
    assert done.returncode == ExitCode.OK, done.stderr
    values = ending(plant)
    assert (values["attempts"], values["goals"]) == ([], [])
    assert values["delta"] == pytest.approx(0.001, abs=2e-4)
    assert "already" in values["exit"]["reason"]
    assert (plant["out"] / "report.html").exists()


def test_interrupt_during_a_motion_stops_the_arm_and_keeps_the_recording(paced_plant, arm):
    process = subprocess.Popen(run_arguments(paced_plant), stderr=subprocess.PIPE, text=True)
    wait_for_motion(paced_plant, arm, "push 1: approach")
    process.send_signal(signal.SIGINT)
    stderr = process.communicate(timeout=600)[1]
    assert process.returncode == ExitCode.INTERRUPTED, stderr
    now = status(paced_plant, arm)
    assert now.state == ExecutorState.HOLD
    assert now.cause == Cause.STOP_REQUESTED
    assert np.abs(now.dq_ref).max() == 0.0
    assert now.lease_holder == ""
    assert "interrupted" in ending(paced_plant)["exit"]["reason"]
    track = joint_track(paced_plant["out"] / "run.mcap", "joint_commands")
    speed = np.abs(np.diff(track.q, axis=0)).max(axis=0) / 1e-3
    assert np.all(speed <= 1.02 * arm.limits.dq_max)
    assert "Traceback" not in stderr


def test_a_terminal_that_is_closed_during_a_motion_stops_the_arm_and_keeps_the_recording(paced_plant, arm):
    ours, theirs = os.openpty()
    heard = ["env", "--default-signal=HUP"]  # also where the tests run under nohup
    process = subprocess.Popen(
        [*heard, "setsid", "--ctty", *run_arguments(paced_plant)], stdin=theirs, stdout=theirs, stderr=theirs
    )
    os.close(theirs)
    wait_for_motion(paced_plant, arm, "push 1: approach")
    os.close(ours)  # the window is closed: SIGHUP, and whatever is printed from now on fails
    assert process.wait(timeout=600) == ExitCode.INTERRUPTED
    now = status(paced_plant, arm)
    assert (now.state, now.cause, now.lease_holder) == (ExecutorState.HOLD, Cause.STOP_REQUESTED, "")
    assert "interrupted" in ending(paced_plant)["exit"]["reason"]
    assert joint_track(paced_plant["out"] / "run.mcap", "joint_commands").q.size


def test_stop_from_another_terminal_ends_the_run_with_six(paced_plant, arm):
    process = subprocess.Popen(run_arguments(paced_plant), stderr=subprocess.PIPE, text=True)
    wait_for_motion(paced_plant, arm, "push 1: approach")
    send_stop(paced_plant["executor"], ArmKeys(), timeout_s=5.0)
    stderr = process.communicate(timeout=600)[1]
    assert process.returncode == ExitCode.PROTECTION, stderr
    assert "STOP_REQUESTED" in ending(paced_plant)["exit"]["reason"]
    assert status(paced_plant, arm).state == ExecutorState.HOLD
    recording = paced_plant["out"] / "run.mcap"
    seen_ns = [note["arm_stamp_ns"] for note in read_notes(recording) if note["kind"] == "view"]
    assert seen_ns  # on the arm's clock, so before it moved, whatever time the host took
    assert max(seen_ns) <= joint_track(recording).stamp_ns[0]


def test_a_stop_while_the_host_plans_ends_the_run_before_its_next_motion(paced_plant, arm):
    process = subprocess.Popen(run_arguments(paced_plant), stderr=subprocess.PIPE, text=True)
    wait_for_motion(paced_plant, arm, "push 1: approach")
    with ExecutorLink(paced_plant["executor"], arm) as link:
        deadline = time.monotonic() + 600
        while (now := link.status()).state != ExecutorState.HOLD or now.lease_holder:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        send_stop(paced_plant["executor"], ArmKeys(), timeout_s=5.0)
    stderr = process.communicate(timeout=600)[1]
    assert process.returncode == ExitCode.PROTECTION, stderr
    assert "by somebody else since" in ending(paced_plant)["exit"]["reason"]
    after = status(paced_plant, arm)
    assert (after.state, after.plan_seq) == (ExecutorState.HOLD, now.plan_seq)


def test_wrong_arm_model_is_refused_before_anything_moves(plant, arm, tmp_path):
    other = tmp_path / "other-arm"
    shutil.copytree(arm.directory, other)
    source = other / "arm.yaml"
    text = source.read_text()
    changed = text.replace("2.618", "2.5", 1)
    assert changed != text
    source.write_text(changed)
    done = run(plant, "--arm", str(other))
    assert done.returncode == ExitCode.REFUSED
    assert "start both with the same arm description" in done.stderr
    assert status(plant, arm).state == ExecutorState.DISARMED


def test_drives_that_speak_another_packing_are_named_and_nothing_is_planned(tmp_path):
    with running_plant(tmp_path, packing="classic") as plant:
        done = run(plant)
        log = (tmp_path / "executor.log").read_text()
    assert done.returncode == ExitCode.UNREACHABLE, done.stderr
    assert "the drives of joint1, joint2" in done.stderr.replace("\n", " ")
    assert "with packing 'classic'" in log


def test_empty_view_is_refused_before_anything_moves(plant, arm):
    camera = f"tcp/127.0.0.1:{free_port()}"
    session = _camera_without_object(camera)
    try:
        done = run({**plant, "camera": camera})
    finally:
        session.close()
    assert done.returncode == ExitCode.REFUSED, done.stderr
    assert "shows 0 points of an object" in ending(plant)["exit"]["reason"]
    assert status(plant, arm).state == ExecutorState.DISARMED


def test_dry_run_plans_the_push_and_moves_nothing(plant, arm):
    done = run(plant, "--dry-run", "--json")
    assert done.returncode == ExitCode.OK, done.stderr
    assert "nothing was moved" in json.loads(done.stdout)["exit"]["reason"]
    assert status(plant, arm).state == ExecutorState.DISARMED


def move_away(plant, arm, q):
    """Bring the arm straight to a posture and switch it off there; its state then."""
    with ExecutorLink(plant["executor"], arm) as link:
        with link.leased():
            start = link.arm_drives().q_ref
            link.wait_done(
                link.send_plan(time_law(np.array([start, q]), arm, TimeLawSettings(speed=0.3)), "away")
            )
            link.disarm()
        return link.status()


def test_dry_run_away_from_home_plans_from_there_without_arming_or_sending_anything(plant, arm):
    before = move_away(plant, arm, arm.q_home + np.array([0.3, -0.1, 0, 0, 0, 0, 0]))
    done = run(plant, "--dry-run", "--json")
    after = status(plant, arm)
    assert done.returncode == ExitCode.OK, done.stderr
    assert "not there and not sent there: joint 'joint1' (index 0)" in done.stderr
    assert (
        json.loads(done.stdout)["exit"]["reason"] == "dry run: the first push is planned, nothing was moved"
    )
    assert after.state == ExecutorState.DISARMED
    assert (after.epoch, after.plan_seq) == (before.epoch, before.plan_seq)  # ARM would have begun an epoch
    # Brakes that take over give way by a tenth of a milliradian; a motion is a hundred times that.
    assert np.allclose(after.q_meas, before.q_meas, atol=1e-3)


def test_absent_executor_ends_with_five_and_its_address(tmp_path):
    plant = {"executor": f"tcp/127.0.0.1:{free_port()}", "camera": "tcp/127.0.0.1:1", "out": tmp_path / "run"}
    done = run(plant)
    assert done.returncode == ExitCode.UNREACHABLE
    assert plant["executor"] in done.stderr.replace("\n", "")
    assert ending(plant)["exit"]["name"] == "UNREACHABLE"
    assert "Traceback" not in done.stderr


def _camera_without_object(endpoint):
    """A camera process that sees an empty table."""
    h, w, f = 240, 320, 230.0
    K = np.array([[f, 0, w / 2], [0, f, h / 2], [0, 0, 1.0]])
    X = look_at(np.array([-0.04, -0.5, 0.6]), np.array([0.6, 0.0, 0.1]))
    v, u = np.mgrid[:h, :w]
    rays = np.stack([(u - K[0, 2]) / f, (v - K[1, 2]) / f, np.ones((h, w))], axis=-1) @ X[:3, :3].T
    depth = np.where(rays[..., 2] < -0.05, -X[2, 3] / np.minimum(rays[..., 2], -0.05), 0.0)
    frame = pb.Frame(
        camera="front", stamp_ns=1, index=1, width=w, height=h, depth_unit_m=1e-3,
        depth_u16=zlib.compress(np.round(1e3 * depth).astype("<u2").tobytes()), K=K.ravel(), X_base_camera=X.ravel(),
    )  # fmt: skip
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    lock = threading.Lock()

    def answer(query):
        with lock:
            query.reply(query.key_expr, codec.seal(frame, codec.Address("camera")))
            query.drop()

    session.declare_queryable(ArmKeys().capture("front"), answer)
    return session
