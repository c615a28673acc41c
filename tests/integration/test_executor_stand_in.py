"""The executor as a process, with its native core, against the stand-in on a stepped clock."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_executor.quintic import sample, spline_through
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import S2RError
from s2r_protocol.faults import Cause, ExecutorState

native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")
pytest.importorskip("mujoco", reason="the stand-in needs mujoco")
link = pytest.importorskip("s2r_host.link")
AnyReader = pytest.importorskip("rosbags.highlevel").AnyReader

pytestmark = pytest.mark.slow
ARM = load_arm("xmate3pro")
STEP = np.array([0.3, 0.2, -0.2, -0.2, 0.3, 0.2, 0.4])
COMMAND = [sys.executable, "-c", "from s2r_protocol.cli.root import main; main()"]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def start(arguments, ready, log):
    with log.open("w") as stream:
        process = subprocess.Popen([*COMMAND, *arguments], stdout=stream, stderr=subprocess.STDOUT)
    deadline = time.monotonic() + 300
    try:
        while not ready.exists():
            assert process.poll() is None, log.read_text()
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.02)
    except BaseException:
        process.kill()
        raise
    return process


@contextmanager
def rig(folder: Path, pace="0", **executor_options):
    """Stand-in and executor in processes of their own."""
    bus, endpoint = f"unix:{folder}/bus.sock", f"tcp/127.0.0.1:{free_port()}"
    common = ["--bus", bus, "--clock", "lockstep", "--pace", pace]
    camera = f"tcp/127.0.0.1:{free_port()}"
    stand_in = start(
        ["sim-arm", "--seed", "3", *common, "--listen", camera, "--ready-file", str(folder / "sim")],
        folder / "sim",
        folder / "sim.log",
    )
    options = {"host-timeout": "5.0", "record": str(folder / "rec"), **executor_options}
    flags = [part for name, value in options.items() for part in (f"--{name}", value)]
    executor = None
    try:
        executor = start(
            ["executor", *common, "--listen", endpoint, *flags, "--ready-file", str(folder / "ready")],
            folder / "ready",
            folder / "executor.log",
        )
        yield SimpleNamespace(endpoint=endpoint, executor=executor, stand_in=stand_in, folder=folder)
    finally:
        for process in (executor, stand_in):
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(60)


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with rig(tmp_path_factory.mktemp("executor")) as started:
        yield started


def children(process):
    return Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()


def move(q0, step, duration_s=2.0, knots=40):
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    s, ds = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration_s
    dds = 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
    return SimpleNamespace(
        t=t, q=np.array(q0) + s[:, None] * step, dq=ds[:, None] * step, ddq=dds[:, None] * step
    )


def read(path):
    """Topic -> (times [s], messages) of a recording, by rosbags."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, stamp_ns, raw in reader.messages():
            topic = connection.topic.rsplit("/", 1)[1]
            times, messages = found.setdefault(topic, ([], []))
            times.append(stamp_ns * 1e-9)
            messages.append(reader.deserialize(raw, connection.msgtype))
    return found


def saved(tmp_path, data):
    path = tmp_path / "plan.mcap"
    path.write_bytes(data)
    return path


def test_an_arm_that_waits_for_long_takes_little_of_the_processor_at_pace_0_and_obeys_at_once(tmp_path):
    with rig(tmp_path) as plant, link.ExecutorLink(plant.endpoint, ARM) as connection:
        deadline = time.monotonic() + 60.0
        begin = connection.status().tick
        while connection.status().tick < begin + 1000:  # disarmed and waiting: it settles
            assert time.monotonic() < deadline
            time.sleep(0.01)
        began, ticks = time.monotonic(), connection.status().tick
        time.sleep(2.0)
        later = connection.status().tick
        passed_s = time.monotonic() - began
        # Ticks of the wall clock would be 1000 a second; a busy machine can only make them fewer.
        assert later > ticks
        assert later - ticks < 1.2 * 100 * passed_s + 100
        with connection.leased():
            assert connection.arm_drives().state == ExecutorState.HOLD


def test_a_killed_host_ends_in_hold_and_the_next_host_goes_on(tmp_path):
    with rig(tmp_path, pace="1", **{"host-timeout": "0.5"}) as started:
        host_process = subprocess.Popen(
            [sys.executable, "-c", _HOST, started.endpoint], stdout=subprocess.PIPE, text=True
        )
        assert host_process.stdout is not None
        assert host_process.stdout.readline().strip() == "moving"
        host_process.kill()
        host_process.wait()
        with link.ExecutorLink(started.endpoint, ARM) as host:
            deadline = time.monotonic() + 300
            while host.status().state != ExecutorState.HOLD:
                assert time.monotonic() < deadline
                time.sleep(0.01)
            status = host.status()
            assert status.cause == Cause.HOST_LOST
            assert 0.0 < status.plan_t < 19.0
            host.meet()  # the arm was stopped since the first hello
            host.take_lease()
            host.wait_done(host.send_plan(move(status.q_ref, -0.1 * STEP, 0.5), "next"))
            host.send_plan(move(host.status().q_ref, STEP, 20.0), "interrupted")
            core = children(started.executor)
            os.kill(started.executor.pid, signal.SIGINT)
            assert started.executor.wait(60) == 0
            assert not any(Path(f"/proc/{pid}").exists() for pid in core)
            host._heart.stop()  # nobody is left to return the lease to
            host._heart = None
        (recording,) = started.folder.glob("rec/session-*.mcap")
        assert read(recording)["executor_state"][1][-1].state == ExecutorState.DISARMED
        interrupted = max(started.folder.glob("rec/plan-*.mcap"), key=lambda p: p.stat().st_mtime)
        assert len(read(interrupted)["joint_states"][0]) > 0


_HOST = """
import sys, time
import numpy as np
from types import SimpleNamespace
from s2r_host.link import ExecutorLink
from s2r_protocol.arms import load_arm
arm = load_arm("xmate3pro")
host = ExecutorLink(sys.argv[1], arm)
host.take_lease()
q = np.tile(host.arm_drives().q_ref, (2, 1))
q[1, 0] += 0.5
still = np.zeros((2, 7))
host.send_plan(SimpleNamespace(t=np.array([0.0, 20.0]), q=q, dq=still, ddq=still), "killed")
while host.status().plan_t < 0.2:
    time.sleep(0.01)
print("moving", flush=True)
time.sleep(60)
"""


def test_a_core_that_dies_ends_the_executor_as_a_protection_stop(tmp_path):
    with rig(tmp_path) as started:
        (core,) = (
            pid
            for pid in children(started.executor)
            if Path(f"/proc/{pid}/comm").read_text().strip() == "s2r-rt"
        )
        os.kill(int(core), signal.SIGKILL)
        assert started.executor.wait(60) == 6
        log = (tmp_path / "executor.log").read_text()
    assert "drives stop by their own watchdogs (killed by SIGKILL)" in log


def test_a_host_hears_that_the_executor_is_being_ended_under_its_motion(tmp_path):
    def move_under_an_end(started, host):
        with host.leased():
            verdict = host.send_plan(move(host.arm_drives().q_ref, STEP, duration_s=6.0), "long")
            time.sleep(1.0)
            started.executor.send_signal(signal.SIGINT)
            host.wait_done(verdict)

    with (
        rig(tmp_path, pace="1") as started,
        link.ExecutorLink(started.endpoint, ARM) as host,
        pytest.raises(S2RError, match="The executor is being ended"),
    ):
        move_under_an_end(started, host)


def test_an_executor_that_no_drive_ever_answered_ends_at_once(tmp_path):
    with rig(tmp_path, packing="classic") as started:
        time.sleep(1.0)  # until it waits for its first answers
        began = time.monotonic()
        started.executor.send_signal(signal.SIGINT)
        assert started.executor.wait(60) == 0
        assert (
            time.monotonic() - began < 12.0
        )  # 2 s on a quiet machine; each of the last ticks used to wait 5 s
    assert "real-time core ended (exit 0)" in (tmp_path / "executor.log").read_text()


def test_a_stand_in_that_goes_away_is_named_as_an_unreachable_bus(tmp_path):
    with rig(tmp_path) as started:
        started.stand_in.terminate()
        started.stand_in.wait(60)
        assert started.executor.wait(60) == 5
        assert "bus.sock" in (tmp_path / "executor.log").read_text()


def test_without_a_bus_the_executor_ends_with_exit_5_and_says_what_to_start(tmp_path):
    result = subprocess.run(
        [
            *COMMAND,
            "executor",
            "--bus",
            f"unix:{tmp_path}/none.sock",
            "--listen",
            f"tcp/127.0.0.1:{free_port()}",
        ],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert result.returncode == 5
    assert "s2r sim-arm" in result.stderr
    assert "Traceback" not in result.stderr


# The last in this file: from the first of them on a stand-in and an executor run.


def test_a_plan_runs_on_the_stand_in_and_rosbags_reads_its_recording(running, tmp_path):
    with link.ExecutorLink(running.endpoint, ARM) as host, host.leased():
        status = host.arm_drives()
        plan = move(status.q_ref, STEP)
        verdict = host.send_plan(plan, "there")
        done = host.wait_done(verdict)
        np.testing.assert_allclose(done.q_ref, plan.q[-1], atol=1e-9)
        np.testing.assert_allclose(done.q_meas, plan.q[-1], atol=5e-3)
        recording = read(saved(tmp_path, host.recording(verdict.seq)))
        back = host.send_plan(move(done.q_ref, -STEP), "back")
        host.wait_done(back)
    times, commands = recording["joint_commands"]
    assert list(commands[0].name) == list(ARM.joint_names)
    np.testing.assert_allclose(np.diff(times), 1e-3, atol=1e-6)
    assert len(times) > 2000
    np.testing.assert_allclose(commands[-1].position, plan.q[-1], atol=1e-9)


def test_a_stop_stays_on_the_path_and_inside_the_limits(running, tmp_path):
    with link.ExecutorLink(running.endpoint, ARM) as host, host.leased():
        status = host.arm_drives()
        plan = move(status.q_ref, STEP, duration_s=30.0)
        verdict = host.send_plan(plan, "stopped")
        while host.status().plan_t < 10.0:
            time.sleep(0.005)
        rest = host.come_to_rest()
        assert rest.state == ExecutorState.HOLD
        assert rest.cause == Cause.STOP_REQUESTED
        assert 10.0 < rest.plan_t < 29.0
        recording = read(saved(tmp_path, host.recording(verdict.seq)))
        host.wait_done(host.send_plan(move(rest.q_ref, status.q_ref - rest.q_ref), "back"))
    spline = spline_through(plan.t, plan.q, plan.dq, plan.ddq)
    np.testing.assert_allclose(rest.q_ref, sample(spline, np.array([rest.plan_t])).q[0], atol=1e-6)
    q = np.array([m.position for m in recording["joint_commands"][1]])
    # The bus carries 4 nrad counts: differences of the third order see them as 4e-9 * 8 / 1e-9.
    limits = ARM.limits
    for order, limit, noise in (
        (1, limits.dq_max, 1e-5),
        (2, limits.ddq_max, 0.02),
        (3, limits.dddq_max, 40.0),
    ):
        assert (np.abs(np.diff(q, n=order, axis=0)) / 1e-3**order <= limit + noise).all()
