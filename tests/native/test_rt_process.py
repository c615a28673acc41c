"""The process s2r-rt over a real local socket, in lock-step with drives in a thread of this process."""

from __future__ import annotations

import os
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from s2r_protocol.faults import Cause, ExecutorState

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")

RT = Path(_native.__file__).with_name("s2r-rt")
FRAME = struct.Struct("<IBBBB")
CANFD_BRS = 0x01
PAUSE = 4  # the core's number
TIMEOUT_S = 20.0


class BusOfOne:
    """Listens on a local socket and answers like a drive set, one frame per packet."""

    def __init__(self, path: Path, drives) -> None:
        self.drives = drives
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.listener.bind(str(path))
        self.listener.listen(1)
        self.connection: socket.socket | None = None
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        try:
            self.connection, _ = self.listener.accept()
            while packet := self.connection.recv(72):
                can_id, length, flags, _, _ = FRAME.unpack(packet[:8])
                fd = len(packet) == 72
                assert flags == (CANFD_BRS if fd else 0)
                for answer_id, data, is_fd in self.drives.answer([(can_id, packet[8 : 8 + length], fd)]):
                    header = FRAME.pack(answer_id, len(data), CANFD_BRS if is_fd else 0, 0, 0)
                    self.connection.send((header + data).ljust(72 if is_fd else 16, b"\0"))
        except OSError:
            pass  # the other side is gone: the tests look at it, not at this

    def drain(self) -> None:
        """Until the drives have taken what the process had sent before it ended."""
        self.thread.join(TIMEOUT_S)
        assert not self.thread.is_alive()

    def close(self) -> None:
        if self.connection:
            self.connection.shutdown(socket.SHUT_RDWR)
        self.listener.close()


class ClassicDrives:
    """Seven perfect CiA 402 drives that latch their RPDO at the SYNC."""

    WORDS = (0x00, 0x40, 0x31, 0x33, 0x37, 0x17, 0x1F, 0x18)
    AFTER: ClassVar = {(1, 0x06): 2, (2, 0x07): 3, (3, 0x0F): 4, (4, 0x02): 5}

    def __init__(self) -> None:
        self.state = [1] * 7
        self.counts = [1000 * j for j in range(7)]
        self.latched = {}
        self.syncs = 0

    def answer(self, frames: list[tuple[int, bytes, bool]]) -> list[tuple[int, bytes, bool]]:
        ((can_id, data, _),) = frames
        if 0x200 < can_id <= 0x207:
            self.latched[can_id - 0x201] = struct.unpack("<Hih", data)
        if can_id != 0x080:
            return []
        for joint, (word, target, _) in self.latched.items():
            self.state[joint] = (
                1 if word == 0 else self.AFTER.get((self.state[joint], word), self.state[joint])
            )
            if self.state[joint] == 4:
                self.counts[joint] = target
        self.syncs += 1
        health = (
            []
            if self.syncs % 8
            else [(0x281 + joint, struct.pack("<hHB", 0, 0, 30), False) for joint in range(7)]
        )
        return [
            (0x181 + joint, struct.pack("<Hih", self.WORDS[self.state[joint]], self.counts[joint], 0), False)
            for joint in range(7)
        ] + health


class Process:
    """s2r-rt and the front end's half of its memory."""

    def __init__(self, shared, **options: object) -> None:
        self.shared = shared
        self.child = subprocess.Popen(
            [RT, "--shm-fd", str(shared.fd)],
            pass_fds=[shared.fd],
            stderr=subprocess.PIPE,
            text=True,
            **options,
        )

    def until(self, condition: Callable, beat: bool = True):
        deadline = time.monotonic() + TIMEOUT_S
        while time.monotonic() < deadline:
            if beat:
                self.shared.beat()
            snapshot = self.shared.snapshot()
            if condition(snapshot):
                return snapshot
            time.sleep(0.002)
        raise AssertionError(f"state {snapshot.state}, cause {snapshot.cause} after {TIMEOUT_S} s")

    def end(self, number: int = signal.SIGTERM) -> int:
        self.child.send_signal(number)
        return self.child.wait(TIMEOUT_S)


@pytest.fixture
def start(tmp_path: Path, core_config: dict, make_drives: Callable) -> Iterator[Callable]:
    """Start drives and s2r-rt; everything ends with the test."""
    started: list = []

    def start_one(classic: bool = False, **config: object) -> tuple[Process, BusOfOne]:
        path = tmp_path / "bus.sock"
        bus = BusOfOne(path, ClassicDrives() if classic else make_drives())
        settings = {**core_config, "bus": f"unix:{path}", "pace": 0.0, "front_end_timeout_s": 5.0, **config}
        if classic:
            settings.update(packing="classic", tick_ns=4_000_000, brake_feedback=False)
        process = Process(_native.Shared.create(settings))
        started.extend((process, bus))
        return process, bus

    yield start_one
    for item in started:
        if isinstance(item, BusOfOne):
            item.close()
        else:
            item.child.kill()
            item.child.wait()
            item.child.stderr.close()


def arm(process: Process):
    snapshot = process.until(lambda s: s.state == ExecutorState.DISARMED and max(s.feedback_age) == 0)
    process.shared.command(1, snapshot.epoch)
    return process.until(lambda s: s.state == ExecutorState.HOLD)


def submit(process: Process, plan, plan_id: int = 1) -> None:
    arrays = (plan.t, plan.q, plan.dq, plan.ddq, plan.stop_duration)
    assert process.shared.submit_plan(plan_id, process.shared.snapshot().epoch, *arrays, 0.0, 0.0)


@pytest.mark.parametrize("classic", [False, True])
def test_plan_runs_over_the_socket_and_sigterm_ends_with_the_drives_off(start, plan_from, classic):
    process, bus = start(classic=classic)
    plan = plan_from(arm(process).q_ref)
    submit(process, plan)
    snapshot = process.until(lambda s: s.plan_done)
    assert np.abs(snapshot.q_ref - plan.q[-1]).max() < 1e-12
    assert np.abs(snapshot.q_meas - plan.q[-1]).max() < 1e-6  # measured one tick before the end
    assert snapshot.late_answers == 0
    assert not snapshot.realtime  # lock-step does not ask for it
    assert process.end() == 0
    bus.drain()
    assert bus.drives.state == [1] * 7
    assert not process.shared.snapshot().alive


def test_lockstep_emits_the_same_setpoints_as_the_stepped_core(start, make_cell, plan_from):
    process, bus = start()
    plan = plan_from(arm(process).q_ref)
    submit(process, plan)
    process.until(lambda s: s.plan_done)
    process.end()
    bus.drain()
    stepped = make_cell()
    stepped.arm()
    stepped.run_plan(plan)
    stepped.until(lambda s: s.plan_done)

    def moving(setpoints: list) -> list:
        positions = [p for _, ctrl, p in setpoints if ctrl == 2]
        return [p for p, following in pairwise(positions) if p != following]

    assert moving(bus.drives.setpoints) == moving(stepped.drives.setpoints)


def test_interrupt_in_the_middle_of_a_plan_stops_on_the_path(start, plan_from, use_of_limits):
    process, bus = start(pace=1.0)
    submit(process, plan_from(arm(process).q_ref))
    process.until(lambda s: s.plan_t > 0.4)
    assert process.end(signal.SIGINT) == 0
    bus.drain()
    emitted = np.array([p for _, ctrl, p in bus.drives.setpoints if ctrl == 2], dtype=np.int64)
    assert use_of_limits(emitted) <= 1.0
    records = process.shared.records(65536)
    assert ExecutorState.STOPPING in records["state"]
    assert records["state"][-1] == ExecutorState.DISARMED


def test_front_end_that_falls_silent_leaves_a_holding_arm(start, plan_from):
    process, bus = start(pace=1.0, front_end_timeout_s=0.2)
    submit(process, plan_from(arm(process).q_ref))
    process.until(lambda s: s.plan_t > 0.4)
    snapshot = process.until(lambda s: s.state == ExecutorState.HOLD, beat=False)
    assert snapshot.cause == Cause.FRONT_END_LOST
    assert not snapshot.plan_done
    assert process.child.poll() is None
    assert bus.drives.state == [4] * 7
    assert process.end() == 0


def test_a_signal_waits_for_a_brake_that_does_not_close_as_long_as_it_is_told(start):
    process, bus = start(quit_timeout_s=0.5)
    arm(process)
    bus.drives.brake_stuck = {0: True}
    began = time.monotonic()
    assert process.end(signal.SIGINT) == 0
    assert 0.5 <= time.monotonic() - began < 5.0
    bus.drain()
    assert 0 not in [
        ctrl for _, ctrl, _ in bus.drives.setpoints[-100:]
    ]  # the power goes by their own watchdogs


def test_closed_bus_ends_the_process(start):
    process, bus = start()
    arm(process)
    bus.close()
    assert process.child.wait(TIMEOUT_S) == 5
    assert "was closed by the other side" in process.child.stderr.read()


def test_quit_command_ends_the_process(start):
    process, bus = start()
    arm(process)
    process.shared.command(_native.QUIT, 0)
    assert process.child.wait(TIMEOUT_S) == 0
    bus.drain()
    assert bus.drives.state == [1] * 7


def pace_of(process: Process, ticks: int) -> float:
    """Simulated over real seconds of the next ticks, less the lag that may be made up for at once."""
    first = process.until(lambda s: True)
    last = process.until(lambda s: s.tick >= first.tick + ticks)
    return (last.tick - first.tick) * 1e-3 / ((last.stamp_ns - first.stamp_ns) * 1e-9 + 0.021)


def test_pace_keeps_a_moving_arm_from_outrunning_the_wall_clock(start, plan_from):
    process, _ = start(pace=2.0)
    submit(process, plan_from(arm(process).q_ref))
    process.until(lambda s: s.plan_t > 0.05)
    assert pace_of(process, 500) <= 2.0
    assert not process.shared.snapshot().plan_done


@pytest.mark.parametrize("pace", [0.0, 2.0])
def test_an_arm_that_waits_never_outruns_the_wall_clock(start, plan_from, pace):
    process, _ = start(pace=pace)
    process.until(lambda s: s.state == ExecutorState.DISARMED and max(s.feedback_age) == 0)
    assert pace_of(process, 300) <= 1.0
    held = arm(process)
    assert pace_of(process, 300) <= 1.0
    submit(process, plan_from(held.q_ref, duration_s=20.0))
    process.until(lambda s: s.state == ExecutorState.RUN)
    process.shared.command(PAUSE, process.shared.snapshot().epoch)
    process.until(lambda s: s.state == ExecutorState.PAUSED)
    assert pace_of(process, 300) <= 1.0


@pytest.mark.realtime
def test_real_clock_plays_a_plan_too(start, plan_from):
    process, _ = start(
        clock="real", overrun_stop_count=16, feedback_stop_ticks=900, feedback_fault_ticks=1000
    )
    plan = plan_from(arm(process).q_ref)
    submit(process, plan)
    snapshot = process.until(lambda s: s.plan_done or s.state > ExecutorState.STOPPING)
    if snapshot.missed:
        pytest.skip(f"this machine stalled: {snapshot.missed} ticks lost in {snapshot.overruns} wake-ups")
    assert snapshot.plan_done
    assert np.abs(snapshot.q_ref - plan.q[-1]).max() < 1e-12


def allowed_cpus(process: Process) -> str:
    status = Path(f"/proc/{process.child.pid}/status").read_text()
    return next(line.split()[1] for line in status.splitlines() if line.startswith("Cpus_allowed_list"))


@pytest.mark.parametrize("cpu", [min(os.sched_getaffinity(0)), max(os.sched_getaffinity(0))])
def test_on_the_real_clock_the_process_runs_on_its_cpu_alone_and_says_so(start, cpu):
    process, _ = start(clock="real", cpu=cpu, realtime_priority=0)
    assert process.until(lambda s: s.alive).cpu == cpu
    assert allowed_cpus(process) == str(cpu)


def test_without_a_cpu_of_its_own_and_in_lockstep_the_kernel_places_the_process(start):
    process, _ = start(cpu=max(os.sched_getaffinity(0)))
    assert process.until(lambda s: s.alive).cpu == -1
    assert allowed_cpus(process) != str(max(os.sched_getaffinity(0)))


def test_a_cpu_that_is_refused_makes_the_process_not_real_time(start):
    process, _ = start(clock="real", cpu=1023)
    snapshot = process.until(lambda s: s.alive)
    assert (snapshot.realtime, snapshot.cpu) == (False, -1)
    process.end()
    assert "not real-time: CPU 1023 refused (Invalid argument)" in process.child.stderr.read()


@pytest.mark.parametrize("arguments", [[], ["--shm-fd"], ["--shm-fd", "x"], ["--shm-fd", "-1"], ["--help"]])
def test_wrong_arguments_print_the_usage(arguments):
    result = subprocess.run([RT, *arguments], capture_output=True, text=True)
    assert result.returncode == 2
    assert result.stderr.startswith("usage: s2r-rt --shm-fd N")


def test_descriptor_that_is_no_shared_block_is_refused(tmp_path):
    with (tmp_path / "empty").open("w+b") as file:
        result = subprocess.run(
            [RT, "--shm-fd", str(file.fileno())], pass_fds=[file.fileno()], capture_output=True
        )
    assert result.returncode == 3
    assert b"are front end and s2r-rt of one build?" in result.stderr


def test_can_interface_that_does_not_exist_is_unreachable(make_cell):
    shared = make_cell(bus="can:nosuch0").shared
    result = subprocess.run(
        [RT, "--shm-fd", str(shared.fd)], pass_fds=[shared.fd], capture_output=True, text=True
    )
    assert result.returncode == 5
    assert "bus 'can:nosuch0'" in result.stderr


def test_quitting_in_motion_waits_for_the_longest_stop_that_admission_allows(tmp_path, make_drives):
    from s2r_executor.config import load_config
    from s2r_executor.core_process import CoreProcess
    from s2r_protocol.arms import load_arm

    config = load_config(overrides={"bus": f"unix:{tmp_path / 'bus.sock'}", "clock": "lockstep"})
    bus = BusOfOne(tmp_path / "bus.sock", make_drives())
    process = CoreProcess(config, load_arm("xmate3pro"))
    core = process.core

    def until(condition):
        deadline = time.monotonic() + TIMEOUT_S
        while not condition(core.snapshot()):
            assert time.monotonic() < deadline
            core.beat()
            time.sleep(0.002)

    until(lambda s: s.tick > 10)
    core.command(1, core.snapshot().epoch)
    until(lambda s: s.state == ExecutorState.HOLD)
    q = np.stack([core.snapshot().q_ref] * 2)
    q[1] += 0.05
    stop_s = np.array([config.admission.stop_duration_max_s])
    core.submit_plan(1, core.snapshot().epoch, np.array([0.0, 8.0]), q, 0 * q, 0 * q, stop_s, 0.0, 0.0)
    until(lambda s: s.plan_t > 3.0)
    assert process.quit() == 0
    assert core.snapshot().state == ExecutorState.DISARMED
    bus.close()
