"""The recorder when its disk or its process fails: what is lost is little, counted, and never the motion's problem."""

from __future__ import annotations

import errno
import os
import resource
import signal
import time

import numpy as np
import pytest

from s2r_executor.config import RecorderConfig
from s2r_executor.observations import Encoder, Timeline
from s2r_executor.recorder import PlanIdentity, Recorder
from s2r_host.log.recover import recover
from s2r_host.log.tables import read_recording

OFFSET_NS = 1_700_000_000_000_000_000


@pytest.fixture
def recorder(tmp_path, arm):
    recorder = Recorder(
        tmp_path,
        arm,
        "/lab/xmate3pro",
        Encoder(arm, Timeline(OFFSET_NS, 1_000_000, stepped=True)),
        RecorderConfig(),
        {},
        publish_period_s=0.001,
    )
    until(lambda: recorder.session_path is not None)
    yield recorder
    recorder.close()


def until(condition, timeout_s=60):
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def feed(recorder, core, ticks, step=20):
    for _ in range(ticks // step):
        core.advance(step)
        recorder.feed(core.records(1000), core.events(), "host:1")
        time.sleep(step * 1e-3)


def test_what_is_half_a_second_old_survives_a_killed_writer(recorder, core, tmp_path):
    session = recorder.session_path
    feed(recorder, core, 600)
    attempts = iter(range(10_000))

    def all_on_disk():
        saved = recover(session, tmp_path / f"seen-{next(attempts)}.mcap")
        return saved.messages and last_tick(saved.path) == core.tick

    until(all_on_disk)  # without another batch: the writer's own clock closes the chunk
    os.kill(recorder.writer_pid, signal.SIGKILL)
    saved = recover(session, tmp_path / "mended.mcap")
    assert last_tick(saved.path) == core.tick
    assert (np.diff(read_recording(saved.path).joints().stamp_ns) == 1_000_000).all()


def last_tick(path):
    return (int(read_recording(path).joints().stamp_ns[-1]) - OFFSET_NS) // 1_000_000


@pytest.mark.realtime
@pytest.mark.parametrize("seed", range(3))
def test_a_killed_writer_costs_at_most_the_open_half_second(recorder, core, tmp_path, seed):
    session = recorder.session_path
    feed(recorder, core, 600 + int(np.random.default_rng(seed).integers(0, 500)))
    size = session.stat().st_size
    until(lambda: session.stat().st_size > 0 and size > 0)
    fed_at_kill = core.tick
    os.kill(recorder.writer_pid, signal.SIGKILL)
    saved = recover(session, tmp_path / "mended.mcap")
    stamps = read_recording(saved.path).joints().stamp_ns
    last_tick = (int(stamps[-1]) - OFFSET_NS) // 1_000_000
    assert fed_at_kill - last_tick <= 500 + 20  # one batch may be under way
    assert (np.diff(stamps) == 1_000_000).all()


def test_after_a_killed_writer_a_new_one_goes_on_and_the_hole_is_counted(recorder, core, tmp_path):
    feed(recorder, core, 200)
    first = recorder.session_path
    os.kill(recorder.writer_pid, signal.SIGKILL)
    until(lambda: (feed(recorder, core, 100), recorder.session_path != first)[1])
    assert recorder.loss.ticks > 0
    feed(recorder, core, 200)
    recorder.close()
    assert len(read_recording(recorder.session_path).joints().stamp_ns) > 0


def test_a_writer_that_cannot_be_started_at_once_is_started_later(recorder, core, monkeypatch):
    monkeypatch.setattr("s2r_executor.recorder._RESTART_S", 0.1)
    start, refused = recorder._start_writer, [2]

    def short_of_memory():
        refused[0] -= 1
        if refused[0] >= 0:
            raise OSError(errno.ENOMEM, "Cannot allocate memory")
        return start()

    monkeypatch.setattr(recorder, "_start_writer", short_of_memory)
    first = recorder.session_path
    os.kill(recorder.writer_pid, signal.SIGKILL)
    until(lambda: (feed(recorder, core, 100), recorder.session_path != first)[1], timeout_s=10)


def test_a_full_disk_is_counted_and_said_and_nobody_waits(recorder, core, tmp_path):
    feed(recorder, core, 100)
    first = recorder.session_path
    resource.prlimit(recorder.writer_pid, resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
    slowest = 0.0

    def fed_until_failed():
        nonlocal slowest
        core.advance(100)
        begin = time.perf_counter()
        recorder.feed(core.records(1000), core.events(), "host:1")
        slowest = max(slowest, time.perf_counter() - begin)
        time.sleep(0.02)
        return recorder.loss.ticks > 0

    until(fed_until_failed)
    assert "File too large" in recorder.loss.reason
    recorder.open_plan(PlanIdentity(1, 7, 2, "host:1", "push"), b"")
    until(lambda: "not recorded: File too large" in recorder.answer(7).reason)
    lost = recorder.loss.ticks
    resource.prlimit(
        recorder.writer_pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    )
    until(lambda: (feed(recorder, core, 100), recorder.session_path != first)[1])  # room again: a new file
    assert recorder.loss.reason == ""
    assert recorder.loss.ticks >= lost
    assert slowest < 5.0  # it never waited for the disk; the bound is for a stalled machine


def test_the_front_ends_death_finishes_the_files(tmp_path, arm, core):
    """The writer outlives the front end by as long as it takes to write the index."""
    recorder = Recorder(
        tmp_path, arm, "/x/y", Encoder(arm, Timeline(OFFSET_NS, 1_000_000, True)), RecorderConfig(), {}
    )
    until(lambda: recorder.session_path is not None)
    feed(recorder, core, 200)
    until(lambda: recorder._queue.empty())
    recorder._connection.shutdown(2)  # what the kernel does for a dead process
    assert recorder._process.wait(60) == 0
    found = read_recording(recorder.session_path)
    assert not found.damage.any
    assert found.has_index


def test_a_writer_that_hangs_is_killed_at_the_end_and_holds_nobody_up(recorder, core, monkeypatch):
    monkeypatch.setattr("s2r_executor.recorder._CLOSE_TIMEOUT_S", 0.5)
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    core.advance(1000)
    records, events = core.records(), core.events()
    while not recorder.loss.ticks:  # until the queue is full
        recorder.feed(records, events, "")
    begin = time.monotonic()
    recorder.close()
    assert time.monotonic() - begin < 30.0
    with pytest.raises(ProcessLookupError):
        os.kill(recorder.writer_pid, 0)
